"""The attack on signs and signals: nothing wrong in a few trials, and a planted fault is found."""

from __future__ import annotations

import attack_conventions

import robustlab.closing


def test_no_number_is_about_another_loop(capsys):
    assert attack_conventions.attack(25, 7) == 0
    assert "no certified number about another loop" in capsys.readouterr().out


def test_a_loop_that_is_closed_with_the_wrong_sign_is_found(monkeypatch):
    monkeypatch.setattr(robustlab.closing, "_sign", lambda value: -1 if value > 0 else 1)
    assert attack_conventions.attack(12, 7) == 1
