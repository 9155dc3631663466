"""Tune two learning rates of RLlib's PPO; each trial has EnvRunners with nodes of their own.

    python examples/ray_tune.py --iterations 20 --runners 1 --cores 2

Needs Ray: pip install -e '.[ray]', in an environment of its own, since Ray pins an older Gymnasium.
"""

import argparse

import ray
from ray import tune
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module.mean_std_filter import MeanStdFilter

import zenostat.ray


def main() -> None:
    """Run the trials and print what each has learned."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--env", default="office-small-USA_CO_Denver-continuous-v1", help="an id under zenostat/")
    parser.add_argument("--begin", default="07-01")
    parser.add_argument("--end", default="07-03")
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--batch", type=int, default=512, help="timesteps per iteration, rounded up to whole episodes")
    parser.add_argument("--runners", type=int, default=1, help="EnvRunners of each trial")
    parser.add_argument("--cores", type=int, default=2, help="cores, and so slots, of each EnvRunner")
    arguments = parser.parse_args()

    zenostat.ray.register()
    config = PPOConfig().environment(
        "zenostat", env_config={"id": arguments.env, "begin": arguments.begin, "end": arguments.end}
    )
    config = zenostat.ray.set_env_runners(config, runners=arguments.runners, cores=arguments.cores)
    config.resources(num_cpus_for_main_process=0)  # so that a trial fits into the cores of its EnvRunners
    config.env_runners(
        env_to_module_connector=lambda *_: MeanStdFilter(),
        batch_mode="complete_episodes",  # so that each iteration has the return that Tune compares
    )
    config.training(lr=tune.grid_search([1e-3, 1e-4]), train_batch_size_per_learner=arguments.batch, minibatch_size=64)
    results = tune.Tuner(
        "PPO",
        param_space=config.debugging(seed=0),
        tune_config=tune.TuneConfig(metric="env_runners/episode_return_mean", mode="max"),
        run_config=tune.RunConfig(stop={"training_iteration": arguments.iterations}, verbose=0),
    ).fit()
    for result in results:
        learned = result.metrics["env_runners"]
        steps = learned["num_env_steps_sampled_lifetime"]
        print(f"lr {result.config['lr']:g}: return {learned['episode_return_mean']:.1f} after {steps:.0f} steps")
    print(f"best: lr {results.get_best_result().config['lr']:g}")


if __name__ == "__main__":
    main()
    ray.shutdown()
