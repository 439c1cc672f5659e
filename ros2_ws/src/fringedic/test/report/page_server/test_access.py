"""Cookies for a token, and the one session that drives."""

from __future__ import annotations

import pytest

from fringedic.errors import OperatorError
from fringedic.report.page_server.access import ABSENT_S, Sessions, Wheel, new_token


def test_cookie_is_given_for_the_token_only_and_outlives_a_restart() -> None:
    token = new_token()
    cookie = Sessions(token).admit(token)
    assert cookie is not None
    assert Sessions(token).admit(token + "x") is None
    assert Sessions(token).name_of(cookie) == cookie.partition(".")[0]
    assert Sessions(new_token()).name_of(cookie) is None, "a session of yesterday"
    forged = "0" + cookie[1:] if cookie[0] != "0" else "1" + cookie[1:]
    for wrong in ("", ".", "name", forged):
        assert Sessions(token).name_of(wrong) is None


def test_first_session_drives_and_hands_over() -> None:
    wheel = Wheel()
    wheel.connect("a", "10.0.0.1")
    wheel.connect("b", "10.0.0.2")
    wheel.require("a")
    with pytest.raises(OperatorError, match=r"browser 1 \(10.0.0.1\) drives: ask for the wheel"):
        wheel.require("b")
    wheel.ask("b")
    wheel.require("a")
    assert wheel.seen_by("a")["asking"] == "browser 2 (10.0.0.2)"
    wheel.give("a")
    wheel.require("b")
    with pytest.raises(OperatorError):
        wheel.give("a")


def test_wheel_of_a_driver_who_left_is_free_after_a_while() -> None:
    now = 100.0
    wheel = Wheel(clock=lambda: now)
    wheel.connect("a", "")
    wheel.connect("b", "")
    wheel.disconnect("a")
    wheel.ask("b")
    assert wheel.present, "a page that is loaded again is away for a moment"
    with pytest.raises(OperatorError):
        wheel.require("b")
    now += ABSENT_S + 1
    assert not wheel.present
    wheel.ask("b")
    wheel.require("b")
