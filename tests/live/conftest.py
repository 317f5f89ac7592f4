"""Shared by the tests of the live link: one session in which nothing goes wrong, with a page that watches."""

import gc
import os
from collections.abc import Iterator
from typing import Any

import pytest
from live_toy import LiveToy, arrivals_of
from toy_session import ECG_HZ, compare_known, register_known, toy_setup, toy_streams

from dvf_ig.live.loop import Answer
from dvf_ig.live.page import PageFeed
from dvf_ig.report.viewer import SceneInput
from dvf_ig.session import Session

UNTIL_S = 14.5


def know_images(patch: pytest.MonkeyPatch) -> None:
    """What is done with pixels is replaced by what the toy's pixels say."""
    patch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", register_known)
    patch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_known)


@pytest.fixture(autouse=True)
def usual_schedule(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A session that a test runs in its own thread gives it real-time priority: not for what follows.

    At its end it unfreezes what the collector leaves out, also what `tests/conftest.py` froze.
    """
    unfreeze, unfrozen = gc.unfreeze, list[None]()
    monkeypatch.setattr(gc, "unfreeze", lambda: unfrozen.append(unfreeze()))  # to count it takes 5 ms a test
    yield
    if unfrozen:
        gc.freeze()
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@pytest.fixture
def known_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `know_images`, for a test."""
    know_images(monkeypatch)


@pytest.fixture(scope="session")
def watched() -> tuple[LiveToy, PageFeed]:
    """The session until UNTIL_S, and what it told its page; the toy has no surface for a scene to show."""

    def scene(given: SceneInput) -> dict[str, Any]:
        return {"schema": "dvf_ig.view/1", "kind": given.kind, "title": given.title}

    with pytest.MonkeyPatch.context() as patch, Session(toy_setup()) as session:
        know_images(patch)
        patch.setattr("dvf_ig.live.page.feed.scene_payload", scene)
        toy, feed = LiveToy(session), PageFeed(session.setup, ECG_HZ, session.history)

        def observe(answer: Answer) -> None:
            toy.answers.append(answer)
            feed.observe(answer)

        toy.loop.observe = observe
        toy.loop.watch = feed.event
        toy.run(arrivals_of(toy_streams(UNTIL_S, chunk=5)), UNTIL_S)
        return toy, feed


@pytest.fixture
def clean(watched: tuple[LiveToy, PageFeed]) -> LiveToy:
    """The session of `watched`."""
    return watched[0]
