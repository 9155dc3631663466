"""`zenostat dataset` on EnergyPlus: a file of the user's, and the environment that Minari recovers without it."""

from pathlib import Path

import numpy as np
import pytest
from support.nodes import SMALL
from support.run_cli import error_of, output_of, plain, run_in_process

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")

SCENARIO = f"""
building: {SMALL["building"]}
weather: {SMALL["weather"]}
steps_per_hour: {SMALL["steps_per_hour"]}
begin: "07-03"
end: "12-31"
time: [hour]
weather_noise: {{dry_bulb_temperature: {{sigma: 1.0, mu: 0.0, tau_h: 24.0}}}}
reward: {{kind: linear}}
"""
ID = "zenostat/office/mixed-v0"


@pytest.mark.slow
def test_cli__data_set_of_a_scenario_file_has_its_environment_within_it(
    scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (scratch / "office.yaml").write_text(SCENARIO)
    call = ["office.yaml", "--controller", "rbc", "--epsilon", "0.2", "--set", "margin=0.5", "--end", "07-03"]
    call += ["--id", ID, "--out", "sets", "--seed", "3"]
    output = output_of("dataset", *call, cwd=scratch)
    assert f"data set {ID}: {scratch / 'sets' / ID}" in output
    assert f"MINARI_DATASETS_PATH={scratch / 'sets'} python" in output
    (scratch / "office.yaml").unlink()

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(scratch / "sets"))
    dataset = minari.load_dataset(ID)
    (episode,) = dataset.iterate_episodes()
    about = dataset.storage.metadata["zenostat"]
    assert about["controllers"] == {"rbc": {"parameters": {"margin": 0.5}, "episodes": 1}}
    assert "dry_bulb_temperature" in about["scenario"]
    assert about["versions"]["energyplus"]
    env = dataset.recover_environment()
    try:
        observation, info = env.reset(seed=3)
        np.testing.assert_array_equal(observation, episode.observations[0])
        for t, action in enumerate(episode.actions):
            effective = zip((a.name for a in env.unwrapped.manifest.actuators), info["effective"], strict=True)
            assert dict(effective) == {name: values[t] for name, values in episode.infos["effective"].items()}
            observation, reward, _, truncated, info = env.step(action)
            np.testing.assert_array_equal(observation, episode.observations[t + 1])
            assert reward == episode.rewards[t]
    finally:
        env.close()
    assert truncated
    assert t == 95


def test_cli__errors_are_one_sentence(scratch: Path) -> None:
    call = ["ref-small-office-USA_CO_Denver-continuous-v1", "--out", str(scratch)]
    error = error_of("dataset", *call, "--controller", "baseline", "--id", ID)
    assert "error: the controller 'baseline' sends no actions" in error
    done = run_in_process("dataset", *call, "--controller", "rbc", "--id", "office")
    assert "error: the id 'office': expected NAMESPACE/NAME-vNUMBER" in plain(done.stderr)
    assert list(scratch.iterdir()) == []
