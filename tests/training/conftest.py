import pytest
import torch


@pytest.fixture(autouse=True)
def one_thread():
    """Tiny networks only wait for a second one, and for long if the machine is busy."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
