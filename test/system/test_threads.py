"""What the system knows of our threads."""

from __future__ import annotations

import sys
import threading
from concurrent.futures import Future
from pathlib import Path

import pytest

from gear_dynamics_ros.system.threads import Doorbell, begin_thread, wake_punctually

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc")


def on_a_thread(action, name=None):
    found = Future()
    thread = threading.Thread(target=lambda: found.set_result(action()), name=name)
    thread.start()
    thread.join()
    return found.result(0.0)


def own(entry):
    return Path(f"/proc/self/task/{threading.get_native_id()}/{entry}").read_text().strip()


def slack():
    return Path(f"/proc/{threading.get_native_id()}/timerslack_ns").read_text().strip()


def test_a_thread_shows_the_first_fifteen_characters_of_its_name():
    def named():
        begin_thread()
        return own("comm")

    assert on_a_thread(named, "engine") == "engine"
    assert on_a_thread(named, "a rather long name") == "a rather long n"


def test_threads_started_by_a_punctual_one_are_punctual():
    def start_another():
        wake_punctually()
        return slack(), on_a_thread(slack)

    assert on_a_thread(start_another) == ("1", "1")
    assert slack() != "1"


def test_a_doorbell_ends_one_wait_however_often_it_rang_before():
    bell = Doorbell()
    assert not bell.wait(0.0)
    bell.ring()
    bell.ring()
    assert bell.wait(None)
    assert not bell.wait(0.0)


def test_a_doorbell_wakes_a_thread_that_waits():
    bell, answer = Doorbell(), Doorbell()
    thread = threading.Thread(target=lambda: bell.wait(None) and answer.ring())
    thread.start()
    assert not answer.wait(0.05)
    bell.ring()
    assert answer.wait(None)
    thread.join()
