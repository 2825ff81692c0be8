"""A custom world: a straight road with traffic at constant speed, in place of the merge.

A world is any object with the methods of hmi_marl.envs.worlds.World. The human model, the rewards,
the observations and both agents work on it as they do on the merge.

Run: python examples/new_world.py --drivers lisa homer --episodes 200
"""

import argparse

import numpy as np

from hmi_marl import Scene, merge_v0
from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import begin, play
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import LANE_WIDTH
from hmi_marl.envs.streams import Stream, uniform
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, Ego, Snapshot

SIZE = np.array([5.0, 2.0])  # length and width of every car [m]
CARS = 8  # in the traffic of each road
SPACING, ACCELERATION = 45.0, 5.0  # along the road, on average [m]; of the driven car [m/s^2]


class StraightRoad:
    """N straight roads. The car changes lanes at once; the others keep their lane and speed."""

    def __init__(self, scene: Scene, num_worlds: int) -> None:
        self.scene, self.num_worlds = scene, num_worlds
        self.x, self.speed, self.target, self.time, self.inflation = np.zeros((5, num_worlds))
        self.lane = np.zeros(num_worlds, np.int64)
        self.crashed = np.zeros(num_worlds, np.bool_)
        # The traffic, shape (N, CARS).
        self.other_x, self.other_speed, self.other_lane = np.zeros((3, num_worlds, CARS))

    def reset(self, seeds, inflation, which):
        """Place the traffic by draws that depend on the seed alone."""
        draw = uniform(seeds[:, None, None], Stream.SCENE, np.arange(3 * CARS).reshape(3, CARS))
        place = SPACING * (np.arange(1, CARS + 1) + 0.5 * draw[:, 0])
        self.other_x = np.where(which[:, None], place, self.other_x)
        self.other_speed = np.where(which[:, None], 20.0 + 8.0 * draw[:, 1], self.other_speed)
        lane = np.floor(draw[:, 2] * self.scene.lanes)  # 0 is the leftmost
        self.other_lane = np.where(which[:, None], lane, self.other_lane)
        self.x, self.time = np.where(which, 0.0, [self.x, self.time])
        self.speed, self.target = np.where(which, 25.0, [self.speed, self.target])
        self.lane = np.where(which, self.scene.lanes - 1, self.lane)
        self.crashed = self.crashed & ~which
        self.perceive(inflation, which)

    def step(self, actions, which):
        """Move the marked worlds by one policy step; ``actions`` index VEHICLE_ACTIONS."""
        seconds = 1.0 / self.scene.policy_frequency
        left, _, right, faster, slower = (
            which & (actions == number) for number in range(len(VEHICLE_ACTIONS))
        )
        lowest, *_, highest = self.scene.target_speeds
        self.lane = np.clip(self.lane - 1 * left + 1 * right, 0, self.scene.lanes - 1)
        self.target = np.clip(self.target + 5.0 * faster - 5.0 * slower, lowest, highest)
        change = np.clip(self.target - self.speed, -ACCELERATION * seconds, ACCELERATION * seconds)
        self.speed = self.speed + which * change
        self.x = self.x + which * seconds * self.speed
        self.other_x = self.other_x + which[:, None] * seconds * self.other_speed
        self.time = self.time + which * seconds
        apart = np.abs(self._relative())  # (N, CARS, 2)
        self.crashed = self.crashed | (which & (apart < SIZE).all(axis=2).any(axis=1))

    def halt(self, which):
        """Stop the driven car of the marked worlds, after a crash."""
        self.speed = np.where(which, 0.0, self.speed)

    def perceive(self, inflation, which):
        """Change the marked worlds' inflation to another driver's."""
        self.inflation = np.where(which, inflation, self.inflation)

    def ego(self):
        """Return the state of the driven cars."""
        along, across = np.moveaxis(self._relative(), 2, 0)
        ahead = (across == 0.0) & (along > 0.0)
        zeros = np.zeros(self.num_worlds)
        return Ego(
            x=self.x,
            y=LANE_WIDTH * self.lane,
            heading=zeros,
            speed=self.speed,
            target_speed=self.target,
            lane=self.lane,
            lateral=zeros,
            crashed=self.crashed,
            gap=np.where(ahead, along, np.inf).min(axis=1) - SIZE[0],
            merging_slowness=zeros,  # no lane merges
        )

    def lidar(self, inflated):
        """Distance and relative radial speed per ray, shape (N, cells, 2)."""
        angle = 2.0 * np.pi * np.arange(self.scene.lidar_cells) / self.scene.lidar_cells
        ray = np.stack([np.cos(angle), np.sin(angle)], axis=1) + 1e-12  # never parallel to a side
        half = SIZE / 2 * (self.inflation if inflated else np.ones(self.num_worlds))[:, None]
        middle, half = self._relative()[:, :, None], half[:, None, None]  # (N, CARS, rays, 2)
        ends = np.sort([(middle - half) / ray, (middle + half) / ray], axis=0)
        enters, leaves = ends[0].max(axis=-1), ends[1].min(axis=-1)  # (N, CARS, rays)
        hit = (enters <= leaves) & (leaves >= 0.0)
        distance = np.where(hit, np.maximum(enters, 0.0), np.inf)
        nearest = distance.argmin(axis=1)  # (N, rays)
        found = np.minimum(distance.min(axis=1), reach := self.scene.lidar_range)
        speed = np.take_along_axis(self.other_speed, nearest, axis=1) - self.speed[:, None]
        opening = np.where(found < reach, speed * ray[:, 0], reach)
        return np.stack([found, opening], axis=2).astype(np.float32)

    def snapshot(self, world):
        """Return the present state of one world, for pictures."""
        own = np.array([self.x[world], LANE_WIDTH * self.lane[world]])
        position = np.vstack([own, own + self._relative()[world]])
        speed = np.append(self.speed[world], self.other_speed[world])
        crashed = np.append(self.crashed[world], np.zeros(CARS, np.bool_))
        time, heading, obstacles = self.time[world], np.zeros(CARS + 1), np.zeros((0, 2))
        return Snapshot(time, position, heading, speed, crashed, obstacles)

    def _relative(self):
        """Middles of the other cars as seen from the driven one [m], shape (N, CARS, 2)."""
        across = LANE_WIDTH * (self.other_lane - self.lane[:, None])
        return np.stack([self.other_x - self.x[:, None], across], axis=2)


parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--drivers", nargs="+", default=["lisa", "homer"], help="(default: lisa homer)")
parser.add_argument("--episodes", type=int, default=200, help="of each (default: %(default)s)")
parser.add_argument("--duration", type=float, default=20.0, help="[s] (default: %(default)s)")
args = parser.parse_args()

scene = Scene(lanes=2).fitted(args.duration)
settings = {"scene": scene, "duration": args.duration}
seeds = np.arange(args.episodes, dtype=np.uint64)
for name in args.drivers:
    config = TeamConfig(driver=name, **settings)
    driver, hmi = make_driver_policy("rule", config), make_hmi("optimal", config)
    teams = begin(config, driver, hmi, seeds, StraightRoad(scene, args.episodes))
    play(teams, driver, hmi)
    speed = teams.ego.x.sum() / (teams.steps.sum() / scene.policy_frequency)
    print(f"{name:<8}{speed:6.1f} m/s, crashes in {teams.ego.crashed.mean():.0%} of the episodes")

# The same world in a PettingZoo environment; make_vec and gymnasium.make take it as well.
env = merge_v0.parallel_env(world=StraightRoad(scene, 1), **settings)
env.reset(seed=0)
while env.agents:
    _, _, _, _, infos = env.step({"driver": 1, "vehicle_ai": 0})  # keep_speed, no_alert
print(f"merge_v0: crashed after keeping its speed: {infos['driver']['crashed']}")
