import asyncio

from hmi_marl.people.play.commits import Commits
from hmi_marl.people.record import Progress


class Live:
    """A trip that notes what becomes of its decisions."""

    def __init__(self, number):
        self.number, self.fate = number, ""

    def progress(self):
        return Progress(0, ((1, 0, None),), False, "", False)

    def saved(self, new):
        self.fate = "saved"

    def failed(self, reason):
        self.fate = reason


def kept(save, count=3):
    """What becomes of trips that are waiting at once, and the batches that were tried."""
    trips, batches = [Live(number) for number in range(count)], []

    def noted(progress):
        batches.append(tuple(progress))
        save(progress)

    async def run():
        commits = Commits(noted)
        for trip in trips:
            commits.add(trip)
        commits.start()
        await commits.close()

    asyncio.run(run())
    return [trip.fate for trip in trips], batches


def test_one_trip_that_is_gone_does_not_harm_the_others():
    def save(progress):
        if 1 in progress:
            raise ValueError("no trip 1")

    fates, batches = kept(save)
    assert fates == ["saved", "no trip 1", "saved"]
    assert batches == [(0, 1, 2), (0,), (1,), (2,)]


def test_a_disk_that_fails_is_tried_once_for_all():
    def save(progress):
        raise OSError("locked")  # after 30 s of waiting, which are not to come once for each trip

    assert kept(save) == (["locked"] * 3, [(0, 1, 2)])
