"""A custom HMI: registered by name, compared with the optimum, exactly and in played episodes.

The HMI here alerts when the driver is distracted, but waits until the last alert has worn off.

Run: python examples/new_hmi.py --driver homer --episodes 64
"""

import argparse

import numpy as np

from hmi_marl import TeamConfig, make_driver_policy, make_hmi, oracle
from hmi_marl.agents.catalogue import HMIS
from hmi_marl.cli import main
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.experiments.episodes import play_episodes


class PatientAlert:
    """Alert when distracted and no accepted alert is in effect.

    An HMI is any object with ``reset`` and ``act``, over a batch of teams.
    """

    def __init__(self, config):
        self._layout = vehicle_ai_layout(config)  # the columns of an observation by name
        self.window = config.alert_window

    def reset(self, seeds, which=None):
        """Begin episodes; this HMI has no memory. ``which`` marks the teams that begin."""

    def act(self, observations):
        """Map observations (N, D) to alerts (N,): 1 for an alert, 0 for none."""
        distracted = self._layout.scalar(observations, "distracted") == 1
        in_effect = self._layout.scalar(observations, "accepted") > 0
        return (distracted & ~in_effect).astype(np.int64)

    def alert_probability(self):
        """Chance of an alert in [t, d, i, c]; the table then quotes the exact return."""
        chance = np.zeros((1, 2, 2, self.window))
        chance[0, 1, 0, :] = 1.0
        return chance


# The registry line: from here on the name works wherever an HMI is named.
HMIS.register("patient", "alerts when distracted and no alert is in effect", PatientAlert)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--driver", default="homer", help="lisa, bart, ... (default: %(default)s)")
    parser.add_argument("--episodes", type=int, default=64, help="played (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=20.0, help="[s] (default: %(default)s)")
    args = parser.parse_args()

    config = TeamConfig(driver=args.driver, duration=args.duration)
    problem = {"driver": args.driver, "window": config.alert_window, "horizon": config.horizon}
    exact = oracle.evaluate(make_hmi("patient", config).alert_probability(), **problem)
    best = oracle.solve_alerts(**problem)
    print(f"{args.driver}, exact attention return over {config.horizon} steps:")
    print(f"  patient {exact.total_return:8.1f}, optimum {best.total_return:8.1f}")

    print(f"mean attention return and alerts over {args.episodes} episodes:")
    driver = make_driver_policy("rule", config)
    for name in ("never", "patient", "optimal"):
        seeds = range(args.episodes)
        played = play_episodes(config, driver, make_hmi(name, config), seeds, world="batched")
        returns, alerts = played.attention_return().mean(), played.alerts.mean()
        print(f"  {name:<8}{returns:8.1f}{alerts:8.1f}")

    # Every command takes the name as well, in a program that has registered it.
    table = f"table --drivers {args.driver} --hmis NoHMI patient own --world batched --workers 1"
    settings = f"--episodes {args.episodes} --duration {args.duration:g} --no-clip"
    main([*table.split(), *settings.split()])
