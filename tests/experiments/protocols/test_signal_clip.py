"""Captions of clips that show signals."""

from dataclasses import replace
from pathlib import Path

from comparisons import hidden

from hmi_marl.experiments.protocols.signal_clip import clips_of, signal_clips


def test_captions_of_clips_say_what_was_measured():
    results = hidden(share=lambda pair: 0.03).tasks["hidden"]
    clips = signal_clips(replace(results, folder=Path("runs")))
    assert len(clips) == 2
    assert all("In 3 % of this run's steps with homer" in clip.caption for clip in clips)
    assert clips_of(replace(results, folder=Path("runs")))["two-stage"]["revealing"] == 0.03
