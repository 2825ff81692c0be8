from typing import Any

import numpy as np
import pytest
from demonstrations import LAYOUT

from hmi_marl.demonstrations.dataset import MISSING
from hmi_marl.demonstrations.recordings import Recording, from_recordings


def recording(steps: int = 3, **given: Any) -> Recording:
    parts: dict[str, Any] = {
        part.name: np.zeros((steps, part.size)) if part.size > 1 else [0.5] * steps
        for part in LAYOUT.parts
    }
    parts["lane"][:, 1] = 1
    parts |= given.pop("parts", {})
    return Recording(parts, **({"actions": [1] * steps, "alerts": [0] * steps} | given))


def test_recorded_drives_become_demonstrations_without_truth() -> None:
    drives = [
        recording(2, driver="ann", crashed=True, alerts=[0, 1]),
        recording(4),
        recording(3, driver="bea", actions=[0, 3, 4]),
        recording(1, driver="ann"),
    ]
    data = from_recordings(drives, LAYOUT, {"study": "a car of ours"})
    observed = data.observed
    assert data.truth is None
    assert observed.seeds is None
    assert observed.names == ("ann", "bea")
    assert observed.labels() == ["ann", None, "bea", "ann"]
    assert observed.length.tolist() == [2, 4, 3, 1]
    assert observed.crash_step.tolist() == [1, MISSING, MISSING, MISSING]
    assert observed.actions.tolist()[2] == [0, 3, 4, -1]
    assert observed.alerts.tolist()[0] == [0, 1, 0, 0]
    assert observed.layout.scalar(observed.states, "speed")[3].tolist() == [0.5, 0, 0, 0]
    assert observed.about == {"study": "a car of ours"}


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        (recording(0), "recording 1 has no steps"),
        (recording(parts={"gaze": [0, 0, 0]}), "recording 1 has not exactly the parts .*: gaze"),
        (recording(parts={"speed": [0.5, 0.5]}), r"1: speed has shape \(3, 1\), not \(2, 1\)"),
        (recording(parts={"speed": [30.0] * 3}), r"speed lies in \[-2, 2\]"),
        (recording(actions=[0, 1, 5]), "recording 1: actions lies in 0 to 4, but got 5"),
        (recording(actions=[0, 1, -1]), "recording 1: actions lies in 0 to 4, but got -1"),
        (recording(actions=[0.5, 1, 1]), "recording 1: actions are whole numbers, not float64"),
        (recording(alerts=[0, 1]), r"recording 1: alerts has shape \(3,\), not \(2,\)"),
        (recording(driver=""), "names are different non-empty strings"),
    ],
)
def test_recordings_are_checked_at_the_door(drive: Recording, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_recordings([recording(), drive], LAYOUT)


def test_no_recordings_are_refused() -> None:
    with pytest.raises(ValueError, match="no recording"):
        from_recordings([], LAYOUT)
