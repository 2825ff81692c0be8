"""HMIs and drivers by name, as the command line and the ``partner=`` keyword take them."""

from __future__ import annotations

import os
from pathlib import Path
from types import MappingProxyType

from hmi_marl.agents.adaptive.catalogue import ADAPT, adaptive_by_name
from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.hmis import AlertWhenDistracted, BeliefAlert, OptimalAlert, RandomAlert
from hmi_marl.agents.learned.policy_files import find_policy, load_policy
from hmi_marl.agents.learned.shipped import PREFIX, is_shipped, shipped_names
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.seats import Policy
from hmi_marl.exact.hidden_attention import DEFAULT_REVEALING
from hmi_marl.names import unknown


def _shipped(kind: str) -> dict[str, str]:
    """The entry for what comes with the package, if anything does."""
    names = ", ".join(shipped_names(kind))
    return {f"{PREFIX}NAME": f"one that comes with the package: {names}"} if names else {}


HMI_NAMES = MappingProxyType(
    {
        "never": "no alerts (NoHMI)",
        "always": "an alert in every step",
        "random": "alerts at a rate: random is random:0.5",
        "when-distracted": "alerts exactly when the driver was distracted in the last step",
        "optimal": "the exact optimum for the driver at the wheel, or optimal:NAME for another "
        "driver model; on the Bayes belief if attention is hidden",
        "average": "the exact optimum for the average driver (AvgHMI), optimal:average",
        "belief": "keeps the Bayes belief over distraction from what the car does, never looking "
        "at the driver; belief:NAME for another driver model, belief:NAME:SHARE to assume that "
        f"such a share of steps shows d instead of {DEFAULT_REVEALING:g}",
        "adapt[:KIND][:bayes]": "gets to know the driver; KIND is expected, choosing or "
        "conditioned; with bayes by the exact posterior instead of the learned encoder",
        "runs/RUN": "the HMI that a training run has learned, by its folder",
    }
    | _shipped(VEHICLE_AI)
)
DRIVER_POLICY_NAMES = MappingProxyType(
    {
        "rule": "keeps lane and gap by what its lidar perceives",
        "random": "any action, evenly",
        "runs/RUN": "the driver that a training run has learned, by its folder",
    }
    | _shipped(DRIVER)
)
_ALIASES = {
    "none": "never",
    "nohmi": "never",
    "own": "optimal",
    "average": "optimal:average",
    "avghmi": "optimal:average",
}


def make_hmi(name: str, config: TeamConfig, sequential: bool = True) -> Policy:
    """The HMI of this name for teams set up by ``config``.

    Args:
        name: one of ``HMI_NAMES``, where case does not matter, a trained run's folder, or
            ``trained:NAME``.
        config: of the teams.
        sequential: False in a parallel environment, where the AI sees a^H one step late; an HMI
            that goes by a^H must know.

    Raises:
        ValueError: unknown name (the message names the nearest), or one that does not fit the
            configuration.
    """
    if not isinstance(name, str):
        raise TypeError(f"an HMI's name is a string, not {name!r}")
    if _is_path(name, HMI_NAMES):
        policy = load_policy(name, VEHICLE_AI, config)
        if policy.sequential and not sequential:
            raise ValueError(
                f"{name} has learned to see a^H_t, which an environment in which both act at once "
                "shows a step late; use the one that takes turns, or train with --no-sequential"
            )
        return policy
    kind, _, argument = _ALIASES.get(name.lower(), name.lower()).partition(":")
    if kind in ("never", "always", "when-distracted") and argument:
        raise ValueError(f"HMI {kind!r} takes no argument, but got {name!r}")
    if kind in ("never", "always"):
        return RandomAlert(float(kind == "always"), config.alerts)
    if kind == "random":
        return RandomAlert(_number(argument or "0.5", "random:RATE"), config.alerts)
    if kind == "when-distracted":
        return AlertWhenDistracted(config)
    if kind == ADAPT:
        if not sequential:
            raise ValueError("an adaptive HMI goes by a^H_t; use an environment that takes turns")
        return adaptive_by_name(argument, config)
    if kind in ("optimal", "belief"):
        model_name, share = argument, ""
        if kind == "belief":
            model_name, share = _split_share(argument)
        model = get_driver(model_name) if model_name else _driver_at_the_wheel(config, kind)
        if kind == "optimal" and config.ai_sees_attention:
            return OptimalAlert(model, config)
        revealing = _number(share, "belief:DRIVER:SHARE") if share else DEFAULT_REVEALING
        return BeliefAlert(model, config, revealing, sequential)
    raise ValueError(unknown("HMI", name, _typed(HMI_NAMES) | _ALIASES))


def make_driver_policy(name: str, config: TeamConfig) -> Policy:
    """The policy of this name for the driver's seat; case does not matter.

    Raises:
        ValueError: unknown name; the message names the nearest.
    """
    if not isinstance(name, str):
        raise TypeError(f"a driver policy's name is a string, not {name!r}")
    if _is_path(name, DRIVER_POLICY_NAMES):
        return load_policy(name, DRIVER, config)
    kind = name.lower()
    if kind == "rule":
        return RuleBasedDriver(config)
    if kind == "random":
        return RandomDriver()
    raise ValueError(unknown("driver policy", name, _typed(DRIVER_POLICY_NAMES)))


def learned_file(name: str, seat: str) -> Path | None:
    """The weights of what was learned, where a name means that; None of a rule.

    Raises:
        FileNotFoundError, ValueError: there are none.
    """
    if not _is_path(name, HMI_NAMES if seat == VEHICLE_AI else DRIVER_POLICY_NAMES):
        return None
    return find_policy(Path(name), seat).with_suffix(".safetensors")


def _typed(names: MappingProxyType[str, str]) -> dict[str, str]:
    """The known names that are typed as they stand, without their arguments."""
    kinds = {name.partition("[")[0]: meaning for name, meaning in names.items()}
    return {kind: meaning for kind, meaning in kinds.items() if kind.islower()}


def _is_path(name: str, known: MappingProxyType[str, str]) -> bool:
    """Whether this means something learned rather than one of the known names."""
    if is_shipped(name) or "/" in name or os.sep in name or name.endswith(".json"):
        return True
    kind = name.lower().partition(":")[0]
    kinds = {each.partition("[")[0] for each in known}
    return kind not in kinds and kind not in _ALIASES and Path(name).is_dir()


def _split_share(argument: str) -> tuple[str, str]:
    """The driver model and the share in DRIVER, DRIVER:SHARE or NAME:β,α,η,inflation:SHARE."""
    model, colon, last = argument.rpartition(":")
    if not colon:
        return argument, ""
    return (argument, "") if "," in last else (model, last)


def _number(text: str, form: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{form} takes a number in [0, 1], not {text!r}") from None


def _driver_at_the_wheel(config: TeamConfig, kind: str) -> Driver:
    driver = config.only_driver
    if driver is None:
        raise ValueError(
            f"HMI {kind!r} means the optimum for the driver at the wheel, but driver= is a "
            f"population; name a driver model, for example {kind}:average"
        )
    return driver
