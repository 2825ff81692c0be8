import pytest
import torch

from hmi_marl.training.runs.processes import Processes, joined


def test_one_process_is_alone(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    processes = joined()
    assert processes == Processes(1, 0, 0)
    assert processes.is_first
    values = torch.tensor([2.0])
    assert processes.gather(values) == [values]
    processes.wait()
    assert processes.seconds_waited == 0
    assert not torch.distributed.is_initialized()


def test_devices():
    assert Processes().device("cpu") == "cpu"
    with pytest.raises(ValueError, match="no device 'quantum': "):
        Processes().device("quantum")


def test_without_a_gpu_auto_is_the_cpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert Processes().device("auto") == "cpu"
    with pytest.raises(ValueError, match="device 'cuda:1' was asked for, but torch sees no GPU"):
        Processes().device("cuda:1")


def test_with_gpus_auto_is_the_processs_own(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch, "empty", lambda *size, device: None)
    assert Processes(count=4, rank=3, local_rank=1).device("auto") == "cuda:1"
