"""Kinds of values of designs: channels by number or by name, weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from robustlab.doors.kinds import Kind
from robustlab.errors import InputError, UsageError, did_you_mean
from robustlab.units import amount


def number(where: str, text: str) -> float:
    """A number, or a usage error."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(where, f"{text.strip()!r}", "a number") from None


@dataclass(frozen=True)
class ByNumber(Kind):
    """Signals by name, or how many of the last ones: ``2`` or ``a,b``."""

    @property
    def metavar(self) -> str | None:
        return "NAME,...|NUMBER"

    def read(self, option: str, given: Any) -> Any:
        if given is None or given.isdecimal():
            return given if given is None else int(given)
        return [part.strip() for part in given.split(",") if part.strip()]

    def field(self) -> Any:
        """A number, or a list of names."""
        from pydantic import Field

        from robustlab.doors.vocabulary import Text

        return Annotated[int, Field(ge=1)] | Annotated[list[Text], Field(min_length=1, max_length=100)]


@dataclass(frozen=True)
class Weight(Kind):
    """A weight: a number, or what the function ``maker`` of robustlab takes, ``bandwidth=10,error=0.01``."""

    maker: str

    @property
    def metavar(self) -> str | None:
        return "WEIGHT"

    def read(self, option: str, given: Any) -> Any:
        """The number, or the model that the function makes."""
        if given is None or "=" not in given:
            return given if given is None else number(option, given)
        from inspect import signature

        import robustlab as rl

        known = list(signature(getattr(rl, self.maker)).parameters)
        found: dict[str, Any] = {}
        for part in given.split(","):
            key, _, value = part.partition("=")
            key = key.strip().replace("-", "_")
            if key not in known:
                expected = f"one of {', '.join(known)}"
                raise UsageError(option, f"unknown word {key!r}", expected, did_you_mean(key, known))
            try:
                found[key] = amount(f"{option}: {key}", value, "rad/s" if key == "bandwidth" else "")
            except InputError as error:
                raise UsageError(error.where, error.found, error.expected) from None
        if "order" in found and found["order"].is_integer():
            found["order"] = int(found["order"])
        if known[0] not in found:
            raise UsageError(option, f"{known[0]} is missing", f"at least {known[0]}=NUMBER")
        return self._made(found)

    def _made(self, found: Mapping[str, Any]) -> Any:
        import robustlab as rl

        return getattr(rl, self.maker)(**found)

    def field(self) -> Any:
        from robustlab.doors import vocabulary

        return vocabulary.Positive | getattr(vocabulary, "".join(p.capitalize() for p in self.maker.split("_")))

    def of_field(self, given: Any) -> Any:
        return given if given is None or isinstance(given, float) else self._made(given.model_dump())
