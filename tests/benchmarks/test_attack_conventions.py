"""The attack on signs and signals: nothing wrong in a few trials, and a planted fault is found."""

from __future__ import annotations

import attack_conventions

from robustlab.signals import TAKES, Taken


def test_no_number_is_about_another_loop(capsys):
    assert attack_conventions.attack(25, 7) == 0
    assert "no certified number about another loop" in capsys.readouterr().out


def test_a_loop_that_is_closed_with_the_wrong_sign_is_found(monkeypatch):
    monkeypatch.setattr(Taken, "sign", property(lambda self: -TAKES[self.takes]))
    assert attack_conventions.attack(12, 7) == 1
