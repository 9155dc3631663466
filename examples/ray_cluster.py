"""Train RLlib's PPO on a Ray cluster of two raylets on this machine, secured with a token.

    python examples/ray_cluster.py --iterations 3

Each raylet has cores for one EnvRunner, which is a node of its own. On several machines, run the same two commands, one
on each, with the same token in RAY_AUTH_TOKEN, and give the address of the head node to `zenostat.ray.connect`.
"""

import argparse
import os
import secrets
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

TOKEN = os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
os.environ["RAY_AUTH_MODE"] = "token"
START_TIMEOUT_S = 180.0


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def raylet(stack: ExitStack, *options: str) -> None:
    """Start a raylet that ends with this program."""
    program = str(Path(sys.executable).with_name("ray"))
    common = ["--node-ip-address=127.0.0.1", "--object-store-memory=100000000", "--disable-usage-stats", "--block"]
    process = subprocess.Popen([program, "start", *options, *common], stdout=subprocess.DEVNULL)
    stack.callback(process.wait)
    stack.callback(process.terminate)


def wait_until(condition: Callable[[], bool], text: str) -> None:
    """Wait until a condition holds; end the program if it does not in time."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while not condition():
        if time.monotonic() > deadline:
            sys.exit(f"after {START_TIMEOUT_S:.0f} s it is not true that {text}")
        time.sleep(0.2)


def main() -> None:
    """Start both raylets, train, and end them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cores", type=int, default=1, help="cores of each raylet, and so slots of each EnvRunner")
    parser.add_argument("--iterations", type=int, default=3)
    parser.add_argument("--batch", type=int, default=256, help="timesteps per iteration, rounded up to whole episodes")
    arguments = parser.parse_args()

    import ray  # after the token has been set
    from ray.rllib.algorithms.ppo import PPOConfig

    import zenostat.ray

    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        address, cores = f"127.0.0.1:{free_port()}", f"--num-cpus={arguments.cores}"
        port = address.rpartition(":")[2]
        raylet(stack, "--head", f"--port={port}", "--include-dashboard=false", f"--temp-dir={folder}", cores)
        wait_until(lambda: answers(port), "the head node listens")
        raylet(stack, f"--address={address}", cores)
        stack.enter_context(zenostat.ray.connect(address))
        wait_until(lambda: sum(node["Alive"] for node in ray.nodes()) == 2, "both raylets are in the cluster")
        zenostat.ray.register()
        building = {"building": "ref-small-office", "weather": "USA_CO_Denver", "begin": "07-03", "end": "07-03"}
        config = PPOConfig().environment("zenostat", env_config={**building, "control": "building"})
        config = zenostat.ray.set_env_runners(config, runners=2, cores=arguments.cores)
        config.resources(num_cpus_for_main_process=0)
        config.env_runners(batch_mode="complete_episodes")  # so that each iteration has a return
        config.training(train_batch_size_per_learner=arguments.batch, minibatch_size=64)
        algorithm = config.debugging(seed=0).build_algo()
        stack.callback(algorithm.stop)
        where = algorithm.env_runner_group.foreach_env_runner(
            lambda _: ray.get_runtime_context().get_node_id(), local_env_runner=False
        )
        print(f"{len(where)} EnvRunners on {len(set(where))} raylets")
        for _ in range(arguments.iterations):
            learned = algorithm.train()["env_runners"]
            steps, mean = learned["num_env_steps_sampled_lifetime"], learned["episode_return_mean"]
            print(f"{steps:.0f} steps, return {mean:.1f}")


def answers(port: str) -> bool:
    """Return whether a program listens on the port."""
    try:
        socket.create_connection(("127.0.0.1", int(port)), 1.0).close()
    except OSError:
        return False
    return True


if __name__ == "__main__":
    main()
