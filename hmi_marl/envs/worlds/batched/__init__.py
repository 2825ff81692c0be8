"""The compiled world: thousands of merges at once, equal to highway-env.

One file per physical idea; each function names the highway-env rule that it restates: ``lanes``,
``neighbours``, ``traffic``, ``control``, ``motion``, ``collisions``, ``lidar``, ``spawn``.
``memory`` is the layout of the numbers, ``kernels`` loops over worlds, ``world`` is the interface.
"""

from hmi_marl.envs.worlds.batched.world import BatchedWorld

__all__ = ["BatchedWorld"]
