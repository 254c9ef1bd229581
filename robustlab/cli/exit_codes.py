"""Exit codes: each way that a command can end gives an exit code and one line on stderr.

5 if stdout is closed or full or memory is used up, 130 after Ctrl-C and SIGTERM, 141 without a line if the reader of
stdout has closed it, 3 if a user's plant file raised, 70 with a report file for a bug in robustlab.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import NoReturn

from robustlab.errors import EXIT_BUG, EXIT_INTERRUPTED, EnvironmentFault, RobustlabError, plain_text, rewritten

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
    """Print a warning without the source line that Python would show."""
    _print_error(f"warning: {plain_text(str(message))}")


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def main_guard(run: Callable[[], int | None]) -> int:
    """Run a command and return its exit code, also of an error."""
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
    """Return the fault of a user's plant file that caused the error, or None."""
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
