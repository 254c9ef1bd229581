"""Everything that is wrong with a file, collected and then raised at once."""

from __future__ import annotations

from dataclasses import dataclass, field

from robustlab.errors import InputError

__all__ = ["Problems"]


@dataclass
class Problems:
    """Findings about one file, in the order in which they were met.

    Attributes
    ----------
    file
        What messages call the file.
    lines
        One finding each, beginning with the path in the file.
    hint
        What to do; the first hint given stays.
    """

    file: str
    lines: list[str] = field(default_factory=list)
    hint: str | None = None

    def add(self, line: str, hint: str | None = None) -> None:
        """Note a finding."""
        self.lines.append(line)
        self.hint = self.hint or hint

    def absorb(self, error: InputError) -> None:
        """Note what a constructor said."""
        where = error.where.removeprefix(f"{self.file}: ").removeprefix(self.file)
        text = f"{error.found}" + (f", expected {error.expected}" if error.expected else "")
        self.add(f"{where}: {text}" if where else text, error.hint)
        self.lines.extend(error.more)

    def raise_any(self) -> None:
        """Raise one `InputError` with all findings, if there are any."""
        if self.lines:
            more = tuple(
                line if line.startswith(f"{self.file}: ") else f"{self.file}: {line}" for line in self.lines[1:]
            )
            raise InputError(self.file, self.lines[0], None, self.hint, more)
