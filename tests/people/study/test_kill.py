"""A server that is killed in mid-study loses nothing that it acknowledged."""

import os
import signal
import subprocess
import sys
import threading
from http.client import HTTPException

import numpy as np
import pytest
from people.study.studies import Rater, a_study

from hmi_marl.people.store import Store
from hmi_marl.people.study.ratings import question_of

RATERS = 3


class Server:
    """``hmi-marl study serve`` in a process of its own."""

    def __init__(self, study, database):
        command = [sys.executable, "-m", "hmi_marl", "study", "serve", str(study.folder)]
        command += [str(database), "--port", "0", "--requests", "100000"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.address = next(word for word in line.split() if word.startswith("http://"))

    def kill(self):
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()


def rate_until_killed(server, raters, after):
    """Raters answer at the same time; the server is killed when so many are acknowledged."""
    lock, done, ended, enough = threading.Lock(), [0], [0], threading.Event()

    def work(number, rater):
        rater.address = server.address
        try:
            if not rater.cookie:
                rater.consent()
            while rater.go_on(number):
                with lock:
                    done[0] += 1
                    if done[0] >= after:
                        enough.set()
        except (OSError, HTTPException):
            pass  # killed
        finally:
            with lock:
                ended[0] += 1
                if ended[0] == len(raters):
                    enough.set()

    threads = [threading.Thread(target=work, args=each) for each in enumerate(raters)]
    for thread in threads:
        thread.start()
    assert enough.wait(120)
    server.kill()
    for thread in threads:
        thread.join(60)
    return done[0]


def check(study, database, raters):
    """All that was acknowledged is there, as it was sent first."""
    with Store(database) as store:
        answers = list(store.answers())
    kept = {(each.session, each.question): each.value for each in answers}
    assert len(kept) == len(answers)
    by_question = {}
    for (session, question), value in kept.items():
        by_question.setdefault(session, {})[question] = value
    assert len(by_question) <= len(raters)
    for rater in raters:
        wanted = {question_of(study.id, page): v for page, v in rater.acknowledged.items()}
        assert any(wanted.items() <= own.items() for own in by_question.values())


def kill_often(tmp_path, kills, seed):
    study = a_study(tmp_path / "study", clips=40, shown=40)
    database, rng = tmp_path / "people.db", np.random.default_rng(seed)
    raters = [Rater("") for _ in range(RATERS)]
    total = 0
    for _ in range(kills):
        total += rate_until_killed(Server(study, database), raters, int(rng.integers(2, 9)))
        check(study, database, raters)
    assert sum(len(rater.acknowledged) for rater in raters) >= total - RATERS >= 2 * kills - RATERS
    server = Server(study, database)
    for rater in raters:  # and each goes on where they were, without a page twice
        rater.address = server.address
        due = rater.due()
        assert due not in rater.acknowledged
        rater.rate(due, 0)
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(30) == 0
    server.process.stdout.close()
    check(study, database, raters)


def test_a_killed_server_loses_nothing_acknowledged(tmp_path):
    kill_often(tmp_path, 1, seed=0)


@pytest.mark.slow
def test_20_times_out_of_20(tmp_path):
    kill_often(tmp_path, 20, seed=1)
