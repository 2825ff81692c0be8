"""A fingerprint of episodes of the batched world: every number of every step, to the bit.

Run as a script it prints the fingerprint of 1,000 episodes.
"""

import hashlib
from dataclasses import fields

import numpy as np

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import Stream, uniform
from hmi_marl.envs.teaming import Teaming


def fingerprint(episodes: int, threads: int | None = None) -> str:
    """Return the SHA-256 of the vehicles, views, observations and rewards of these episodes."""
    from hmi_marl.envs.worlds import make_world

    config = TeamConfig(driver=["lisa", "marge", "bart", "homer"])
    world = make_world("batched", config.scene, episodes, threads)
    teams = Teaming(config, episodes, world)
    seeds = np.arange(episodes, dtype=np.uint64)
    teams.reset(seeds)
    digest = hashlib.sha256()

    def add(*arrays):
        for array in arrays:
            digest.update(np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).data)

    for step in range(config.horizon):
        draws = uniform(seeds, Stream.DRIVER_POLICY, np.full(episodes, step, np.uint64))
        add(world._floats, *(getattr(teams.ego, field.name) for field in fields(teams.ego)))
        add(teams.observe("driver"), teams.observe("vehicle_ai"), teams.state())
        teams.intend((draws * 5).astype(np.int64))
        result = teams.step((draws * 17).astype(np.int64) % 2)
        add(*result.terms.values(), *result.rewards.values())
    return digest.hexdigest()


if __name__ == "__main__":
    print(fingerprint(1000))
