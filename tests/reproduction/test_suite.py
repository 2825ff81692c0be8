import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hmi_marl.reproduction.report import NUMBERS, PAGE

TINY = """
import sys
from pathlib import Path
from hmi_marl.experiments.adaptation.settings import AdaptReproduction, AdaptSettings
from hmi_marl.experiments.attentive_drivers import AttentiveSettings
from hmi_marl.reproduction.suite import FullSettings, reproduce_all
from hmi_marl.experiments.graded_alerts import GradedSettings
from hmi_marl.experiments.hidden_attention import HiddenSettings
from hmi_marl.experiments.metrics_table.reproduction import ReproductionSettings
from hmi_marl.experiments.latent_traits.settings import AssessSettings, TraitReproduction
from hmi_marl.training.ppo.settings import PPOSettings
from hmi_marl.training.traits.settings import TraitSettings

if __name__ == "__main__":
    learn = TraitSettings(pool=1, num_teams=2, ppo=PPOSettings(num_mini_batches=1), steps=1,
                          imitation_updates=1, encoder_units=4, device="cpu")
    settings = FullSettings(
        table=ReproductionSettings(1, 1, 4, 16),
        driver=AttentiveSettings(1, 1, 8, 16),
        hidden=HiddenSettings(1, 1, 4, 4, 16),
        adapt=AdaptReproduction(
            320, 1, 1, 4, 16, judge=AdaptSettings(4, 2, 1, 2, 2)
        ),
        traits=TraitReproduction(1, 2000, 4, learn, judge=AssessSettings(10, 1, 2)),
        graded=GradedSettings(1, 4, 16),
    )
    reproduce_all(settings, Path(sys.argv[1]), 2, "hmi-marl reproduce", "hmi-marl reproduce")
"""


def started(folder: Path) -> subprocess.Popen:
    script = folder.with_suffix(".py")
    script.write_text(TINY)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, script, folder], env=environment, **quiet)


@pytest.mark.slow
def test_a_whole_reproduction_killed_three_times_ends_with_the_same_report(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    began = time.monotonic()
    assert started(tmp_path / "straight").wait() == 0
    whole = time.monotonic() - began
    cut, rng = tmp_path / "cut", random.Random(0)
    for _ in range(3):
        process = started(cut)
        time.sleep(rng.uniform(0.1, 0.4) * whole)
        process.kill()
        assert process.wait() != 0, "it was done before it was killed"
    assert started(cut).wait() == 0
    for name in (PAGE, NUMBERS):
        assert (cut / name).read_bytes() == (tmp_path / "straight" / name).read_bytes()
