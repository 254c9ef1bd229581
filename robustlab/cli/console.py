"""Output of all commands: results on stdout, notes and the progress display on stderr.

``--progress auto`` is on a terminal a bar with elapsed and remaining time, from two seconds to the end; elsewhere only
the lines that some commands always print.
"""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import robustlab as rl
from robustlab.errors import (
    EXIT_BUG,
    EXIT_INTERRUPTED,
    EnvironmentFault,
    InputError,
    RobustlabError,
    UsageError,
    plain_text,
    rewritten,
)

if TYPE_CHECKING:
    from robustlab.report.drawings import Picture


SCHEMA = "robustlab.result/1"
FIGURE = "Figures to write, SVG and PNG: NAME, one of several NAME-...; or FOLDER/."


class _Redirected:
    """A replacement of stdout that writes to stderr, until `emit` restores it."""

    def __init__(self, stdout: Any) -> None:
        self.stdout = stdout
        try:
            is_first = stdout.fileno() == 1
        except (OSError, ValueError, AttributeError):  # a stream in memory has no number
            is_first = False
        self.number = os.dup(1) if is_first else None
        if is_first:  # also redirects compiled libraries and child processes
            stdout.flush()
            os.dup2(2, 1)

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)

    def restore(self) -> None:
        if self.number is not None:
            os.dup2(self.number, 1)
            os.close(self.number)
        sys.stdout = self.stdout


def result_alone() -> None:
    """Redirect stdout to stderr until `emit`, for commands that run a user's code."""
    if not isinstance(sys.stdout, _Redirected):
        sys.stdout = _Redirected(sys.stdout)


def emit(command: str, result: Mapping[str, Any], text: str, as_json: bool) -> None:
    """Print the result on stdout: ``text``, or one JSON object with ``--json``."""
    if isinstance(sys.stdout, _Redirected):
        sys.stdout.restore()
    if as_json:
        from robustlab.result import plain

        print(json.dumps({"schema": SCHEMA, "command": command, **plain(result)}, indent=2, allow_nan=False))
    else:
        # Names from files may contain escape sequences.
        print("\n".join(plain_text(line) for line in text.splitlines()))


def note(text: str) -> None:
    print("\n".join(plain_text(line) for line in text.splitlines()), file=sys.stderr)


def named(signals: Iterable[rl.Signal]) -> list[str]:
    return [f"{s.name} [{s.unit}]" if s.unit else s.name for s in signals]


def save_figures(pictures: Mapping[str, Picture], path: str) -> list[str]:
    """Write each figure as SVG and PNG, in a folder or with names that begin as ``path``; return the paths."""
    from robustlab.report.style import save_figure

    target, made = Path(path), list[str]()
    alone = path.endswith(("/", os.sep)) or target.is_dir()
    if not (alone or target.stem):
        raise InputError("--figure", repr(path), "a name, for example design.svg, or a folder")
    stem = target.stem if target.suffix.lower() in (".svg", ".png") else target.name
    for name, picture in pictures.items():
        place = (target, name) if alone else (target.parent, f"{stem}-{name}" if made else stem)
        made += map(str, save_figure(picture.figure, *place))
    return made


MODES = ("auto", "none")
PATIENCE = 2.0  # s until the bar appears
EVERY = 0.25  # s between two updates of the bar


@contextmanager
def shown(
    progress: str, command: str, total: int | None = None, *,
    lines: bool = False, verbose: bool = False, budgets: bool = True,
) -> Iterator[Display]:  # fmt: skip
    from robustlab.budget import listening

    if progress not in MODES:
        raise UsageError(f"--progress {progress}", "no such mode", f"one of {', '.join(MODES)}")
    mode = progress
    if mode == "auto":
        mode = "lines" if verbose else "bar" if sys.stderr.isatty() else "lines" if lines else "none"
    display = Display(command, mode, total)
    with listening(display.work if budgets and mode == "bar" else None), display:
        yield display


class Display:
    """The display of texts and counts of a command."""

    def __init__(self, command: str, mode: str, total: int | None = None) -> None:
        self.command, self.mode, self.total = command, mode, float(total or 0)
        self._text, self._done = "", 0.0
        self._kept: list[str] = []  # lines above the bar
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._bar, daemon=True)

    def __enter__(self) -> Display:
        if self.mode == "bar":
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        for text in self._kept:
            note(text)

    def __call__(self, text: str) -> None:
        self._text = text
        if self.mode == "lines":
            note(text)

    def done(self, text: str) -> None:
        """Keep a line on a terminal; elsewhere it was printed at the start of the step."""
        if self.mode == "bar":
            self._kept.append(text)

    def step(self, done: float, text: str = "") -> None:
        self._done = done
        if text:
            self(text)

    def work(self, done: float, whole: float) -> None:
        self._done, self.total = done, whole

    @property
    def listener(self) -> Display | Callable[[str], None]:
        """Return the listener of a search in parts: the display where it shows numbers, else a printer of lines."""
        return self if self.mode == "bar" else self.__call__

    def part(self, done: float, expected: float, text: str) -> None:
        """Set the work done and expected in the current part of a search."""
        self._done, self.total, self._text = done, expected, text

    def _bar(self) -> None:
        began = time.monotonic()
        if self._over.wait(PATIENCE):
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(bar_width=24),
                   TimeElapsedColumn(), TimeRemainingColumn())  # fmt: skip
        with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as bar:
            task = bar.add_task(self.command, total=None)
            bar.tasks[0].start_time = bar.get_time() - (time.monotonic() - began)
            while True:
                while self._kept:
                    bar.console.print(plain_text(self._kept.pop(0)), markup=False, highlight=False)
                text = plain_text(f"{self.command}: {self._text}" if self._text else self.command)[-80:]
                bar.update(task, description=text, completed=self._done, total=self.total or None)
                if self._over.wait(EVERY):
                    return


# --- exit codes: each way that a command can end gives one, and a line on stderr --------------------------------------
# 5 if stdout is closed or full or memory is used up, 130 after Ctrl-C and SIGTERM, 141 without a line if the reader of
# stdout has closed it, 3 if a user's plant file raised, 70 with a report file for a bug in robustlab.

EXIT_READER_GONE = 141  # 128 + SIGPIPE

# Errors of the machine: the disk is full, the folder is read-only, a quota or the memory is used up.
_MACHINE_FAULTS = {
    errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EMFILE, errno.ENOMEM,
    errno.EAGAIN, errno.EBADF,
}  # fmt: skip
# Messages of the loader, numpy and the threading library when memory is used up.
_MORE = "more memory, a higher ulimit -v, or a smaller task"
_NO_MEMORY = ("failed to map segment", "cannot allocate memory", "can't start new thread", "out of memory")


def ready_streams() -> None:
    """Treat SIGTERM as Ctrl-C, print warnings in one line, and replace closed streams."""
    # A file opened later would otherwise get the number of a closed stream, and receive its output.
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            os.set_inheritable(number, True)  # a child process needs the three as well
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123  for the rest of the process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for terminals that lack a character
    if hasattr(signal, "SIGTERM") and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _interrupt)
    warnings.showwarning = _print_warning
    if sys.stdout is None:
        raise EnvironmentFault("robustlab", "stdout is closed", "somewhere to print the result (> /dev/null)")


def _print_warning(message: Warning | str, *_where: object, **_more: object) -> None:
    _print_error(f"warning: {plain_text(str(message))}")


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def main_guard(run: Callable[[], int | None]) -> int:
    try:
        code = int(run() or 0)
        sys.stdout.flush()
        return code
    except BaseException as error:  # noqa: BLE001  the outermost handler
        code = _code_of(error)
        _silence()
        return code


def answer(command: Callable[[], int | None]) -> int:
    """Return the exit code of a command that returns or raises the parser's Exit."""
    try:
        return int(command() or 0)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except Exception as stop:
        code = getattr(stop, "exit_code", None)  # Exit: its class is click's, or typer's own copy of it
        if isinstance(stop, RobustlabError) or hasattr(stop, "show") or not isinstance(code, int):
            raise
        return code


def _code_of(error: BaseException) -> int:
    if isinstance(error, RobustlabError):
        if error.hint:
            from robustlab.operations.declaration import reading_option

            error.hint = rewritten(error.hint, reading_option)
        _print_error(f"error: {error}")
        return error.exit_code
    if isinstance(error, KeyboardInterrupt) or type(error).__name__ == "Abort":  # the parser's, likewise
        _print_error(str(error) or "interrupted")
        return EXIT_INTERRUPTED
    if isinstance(error, BrokenPipeError):
        return EXIT_READER_GONE
    fault = _user_fault(error) or _machine_fault(error)
    if fault is not None:
        _print_error(f"error: {fault}")
        return fault.exit_code
    show, code = getattr(error, "show", None), getattr(error, "exit_code", None)
    if callable(show) and isinstance(code, int):
        show(sys.stderr)  # a usage error of the parser
        return code
    _print_error(f"internal error: {plain_text(f'{type(error).__name__}: {error}')}; {_bug_report()}")
    return EXIT_BUG


def _user_fault(error: BaseException) -> RobustlabError | None:
    loader = sys.modules.get("robustlab.dynamics.plant_file")  # no such file was run where it is not loaded
    if loader is None or not isinstance(error, Exception) or isinstance(error, MemoryError):
        return None
    return loader.fault_of_user_code(error)


def _machine_fault(error: BaseException) -> EnvironmentFault | None:
    words = plain_text(next(iter(str(error).strip().splitlines()), ""))
    if isinstance(error, MemoryError):
        return EnvironmentFault("robustlab", f"not enough memory{f' ({words})' if words else ''}", _MORE)
    text = "\n".join(str(cause).lower() for cause in _causes(error))
    sign = next((sign for sign in _NO_MEMORY if sign in text), None)
    if sign and isinstance(error, (ImportError, OSError, RuntimeError)):
        return EnvironmentFault("robustlab", f"not enough memory ({sign})", _MORE)
    if isinstance(error, ImportError) and error.name and error.name.split(".")[0] != "robustlab":
        return EnvironmentFault(
            "robustlab", f"{error.name} cannot be loaded ({words})", "a sound installation (robustlab doctor)"
        )
    if not isinstance(error, OSError) or error.errno not in _MACHINE_FAULTS:
        return None
    if error.filename is None:
        return EnvironmentFault("robustlab", str(error.strerror))
    return EnvironmentFault(str(error.filename), f"{error.strerror}; what was there before is kept")


def _causes(error: BaseException | None) -> list[BaseException]:
    found: list[BaseException] = []
    while error is not None and error not in found:
        found.append(error)
        error = error.__cause__ or error.__context__
    return found


def _print_error(text: str) -> None:
    with suppress(OSError):  # stderr may be closed or full, too
        print(text, file=sys.stderr, flush=True)


def _silence() -> None:
    """Replace streams that cannot be written: Python flushes them once more at exit."""
    for stream in (sys.stdout, sys.stderr):
        if stream is None:
            continue
        try:
            stream.flush()
        except OSError:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)


def _bug_report() -> str:
    import tempfile
    import traceback

    from robustlab.provenance import library_versions

    text = f"command: {sys.argv}\nversions: {library_versions()}\n\n{traceback.format_exc()}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="robustlab-bug-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
        return f"please report it with {file.name}"
    except OSError:
        return f"please report it:\n{text}"
