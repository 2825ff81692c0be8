"""HMIs and driver policies by name, as the command line and ``partner=`` take them.

To add one, register a function that makes it from the configuration of the teams::

    HMIS.register("mine", "alerts every tenth step", make)  # make(config) -> Policy

With ``argument="[:RATE]"`` the name may be followed by an argument, which the function gets as
text, empty if there is none: ``make(config, argument, sequential)`` for an HMI,
``make(config, argument)`` for a driver policy. In place of a function a longer name may stand, such
as ``"random:0.1"``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from hmi_marl.agents.adaptive.hmis import adaptive_by_name
from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.hmis import AlertWhenDistracted, BeliefAlert, OptimalAlert, RandomAlert
from hmi_marl.agents.learned.cards import PREFIX, is_shipped, shipped_names
from hmi_marl.agents.learned.policy import LearnedPolicy, find_policy, load_policy
from hmi_marl.agents.mixture import Mixture
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.seats import Policy
from hmi_marl.exact.hidden_attention import DEFAULT_REVEALING
from hmi_marl.registry import Registry

Factory = Callable[..., Policy]

HMIS: Registry[Factory | str] = Registry("HMI")
DRIVER_POLICIES: Registry[Factory | str] = Registry("driver policy")
_REGISTRIES = {VEHICLE_AI: HMIS, DRIVER: DRIVER_POLICIES}
_MIXTURE = "mixture"


def make_hmi(name: str, config: TeamConfig, sequential: bool = True) -> Policy:
    """Make the HMI of this name for teams set up by ``config``.

    Args:
        name: one of ``HMIS``, where case does not matter, the folder of a training run,
            ``trained:NAME``, or several of these, ``mixture:NAME,NAME,...``.
        sequential: False where both agents move simultaneously: the HMI sees a^H one step late.

    Raises:
        ValueError: an unknown name (the message suggests the nearest), or an HMI that does not fit
            the configuration.
    """
    policy = _make(name, VEHICLE_AI, config, sequential)
    if isinstance(policy, LearnedPolicy) and policy.sequential and not sequential:
        raise ValueError(
            f"{name} has learned to see a^H_t, which an environment with simultaneous moves shows "
            "a step late; use one with sequential moves, or train with --no-sequential"
        )
    return policy


def make_driver_policy(name: str, config: TeamConfig) -> Policy:
    """Make the driver policy of this name for teams set up by ``config``.

    The name is one of ``DRIVER_POLICIES``, else as for :func:`make_hmi`.

    Raises:
        ValueError: an unknown name; the message suggests the nearest.
    """
    return _make(name, DRIVER, config)


def known_names(seat: str) -> dict[str, str]:
    """Names of all policies for a seat, with their lines of help."""
    role = "HMI" if seat == VEHICLE_AI else "driver"
    names = _REGISTRIES[seat].helps()
    names["runs/RUN"] = f"the {role} learned by a training run, by the folder of the run"
    if shipped := ", ".join(shipped_names(seat)):
        names[f"{PREFIX}NAME"] = f"a trained {role} that comes with the package: {shipped}"
    return names


def is_learned(name: str, seat: str) -> bool:
    """Whether a name stands for a policy in a file rather than for a registered one."""
    kind, colon, _ = name.partition(":")
    if colon and kind in _REGISTRIES[seat]:  # such as mixture:..., or optimal:measured/visitor.json
        return False
    if is_shipped(name) or "/" in name or os.sep in name or name.endswith(".json"):
        return True
    return kind not in _REGISTRIES[seat] and Path(name).is_dir()


def mixed_names(name: str) -> tuple[str, ...]:
    """Return the names in ``mixture:NAME,NAME,...``; none if the name stands for no mixture."""
    kind, colon, names = name.partition(":")
    return tuple(names.split(",")) if colon and kind.lower() == _MIXTURE else ()


def learned_file(name: str, seat: str) -> Path | None:
    """Return the weights' file if the name stands for a learned policy, else None.

    Raises:
        FileNotFoundError, ValueError: the policy cannot be found.
    """
    return find_policy(name, seat).with_suffix(".safetensors") if is_learned(name, seat) else None


def _make(name: str, seat: str, config: TeamConfig, *sequential: bool) -> Policy:
    registry = _REGISTRIES[seat]
    if not isinstance(name, str):
        raise TypeError(f"the name of the {registry.kind} is a string, not {name!r}")
    if is_learned(name, seat):
        return load_policy(name, seat, config)
    entry, argument = registry.split(name)
    if isinstance(entry.value, str):
        return _make(entry.value, seat, config, *sequential)
    return entry.value(config, argument, *sequential) if entry.argument else entry.value(config)


def _mixture(seat: str, config: TeamConfig, argument: str, *sequential: bool) -> Policy:
    mixture = f"{_MIXTURE}:{argument}"
    names = argument.split(",")
    if len(names) < 2 or not all(names):
        raise ValueError(
            f"{_MIXTURE}:NAME,NAME,... takes two policies or more, separated by single commas, not "
            f"{mixture!r}"
        )
    make = make_hmi if seat == VEHICLE_AI else make_driver_policy
    policies = []
    for name in names:
        try:
            policies.append(make(name, config, *sequential))
        except (FileNotFoundError, ValueError) as error:
            kind = FileNotFoundError if isinstance(error, FileNotFoundError) else ValueError
            raise kind(
                f"{name!r} in {mixture!r}: {error} (commas separate the policies of a mixture: no "
                "path or name in it can contain one)"
            ) from None
    try:
        return Mixture(policies, seat)
    except ValueError as error:
        raise ValueError(f"{mixture!r}: {error}") from None


def _random(config: TeamConfig, argument: str, sequential: bool) -> Policy:
    return RandomAlert(_number(argument or "0.5", "random:RATE"), config.alerts)


def _optimal(config: TeamConfig, argument: str, sequential: bool) -> Policy:
    driver = _driver(argument, config, "optimal")
    if config.ai_sees_attention:
        return OptimalAlert(driver, config)
    return BeliefAlert(driver, config, DEFAULT_REVEALING, sequential)


def _belief(config: TeamConfig, argument: str, sequential: bool) -> Policy:
    name, colon, share = argument.rpartition(":")
    if not colon or "," in share:  # DRIVER, or NAME:β,α,η,inflation
        name, share = argument, ""
    revealing = _number(share, "belief:DRIVER:SHARE") if share else DEFAULT_REVEALING
    return BeliefAlert(_driver(name, config, "belief"), config, revealing, sequential)


def _adapt(config: TeamConfig, argument: str, sequential: bool) -> Policy:
    if not sequential:
        raise ValueError("an adaptive HMI needs a^H_t; use an environment with sequential moves")
    return adaptive_by_name(argument.lower(), config)


def _driver(name: str, config: TeamConfig, kind: str) -> Driver:
    """The driver model of this name, or without a name the only driver of the teams."""
    if name:
        return get_driver(name)
    if config.only_driver is None:
        raise ValueError(
            f"HMI {kind!r} is the optimum for the driver of the team, but driver= is a population; "
            f"name a driver model, for example {kind}:average"
        )
    return config.only_driver


def _number(text: str, form: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{form} takes a number in [0, 1], not {text!r}") from None


HMIS.register("never", "no alerts (NoHMI)", "random:0", ("none", "NoHMI"))
HMIS.register("always", "an alert in every step", "random:1")
HMIS.register("random", "alerts at a rate, by default 0.5", _random, argument="[:RATE]")
HMIS.register(
    "when-distracted",
    "alerts exactly when the driver was distracted in the last step",
    AlertWhenDistracted,
)
HMIS.register(
    "optimal",
    "the exact optimum for the driver of the team, or for another driver model; on the Bayes "
    "belief if attention is hidden",
    _optimal,
    ("own",),
    "[:DRIVER]",
)
HMIS.register(
    "average",
    "the exact optimum for the average driver (AvgHMI), optimal:average",
    "optimal:average",
    ("AvgHMI",),
)
HMIS.register(
    "belief",
    "alerts by the Bayes belief over distraction, inferred from the car's actions without seeing "
    "the driver; SHARE is the assumed share of steps that reveal d, by default "
    f"{DEFAULT_REVEALING:g}",
    _belief,
    argument="[:DRIVER[:SHARE]]",
)
HMIS.register(
    "adapt",
    "infers the driver's traits while driving; KIND is expected, choosing or conditioned; with "
    "bayes by the exact posterior instead of the learned encoder",
    _adapt,
    argument="[:KIND][:bayes]",
)
DRIVER_POLICIES.register(
    "rule", "keeps lane and gap by the distances that its lidar perceives", RuleBasedDriver
)
DRIVER_POLICIES.register(
    "random", "any of the five actions with equal probability", lambda _: RandomDriver()
)
for _seat, _registry in _REGISTRIES.items():
    _registry.register(
        _MIXTURE,
        "in each episode one of these, drawn from its seed with equal chances",
        partial(_mixture, _seat),
        argument=":NAME,NAME[,...]",
    )
