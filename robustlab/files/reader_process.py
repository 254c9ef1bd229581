"""The child process that opens untrusted files: ``python -m robustlab.files.reader_process``.

`robustlab.files.isolation` starts it. Arguments: kind (``hdf5``, ``matlab5``), path, name of the file for messages,
group or an empty text, the limits as JSON. It answers on stdout with a tree or an error; a crash or a hang is seen by
the parent.
"""

from __future__ import annotations

import json
import sys

from robustlab.errors import InputError
from robustlab.files.limits import Limits
from robustlab.files.wire import send_error, send_tree

__all__ = ["main"]

# What Python, numpy and h5py (or scipy) take of the address space before a file is opened, with room to spare.
BASE_ADDRESS_SPACE = 2 << 30


def _limit_resources(limits: Limits) -> None:
    try:
        import resource
    except ImportError:  # Windows: the parent's time limit remains
        return
    seconds = int(limits.seconds) + 1
    wanted = {
        resource.RLIMIT_AS: BASE_ADDRESS_SPACE + 4 * limits.total,
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_FSIZE: 0,  # a reader writes no files
    }
    for kind, value in wanted.items():
        _, hard = resource.getrlimit(kind)
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (value, hard))


def main(arguments: list[str]) -> int:
    """Read one file and send it."""
    kind, path, shown, group, limits_json = arguments
    limits = Limits(**json.loads(limits_json))
    _limit_resources(limits)
    answer = sys.stdout.buffer
    try:
        if kind == "hdf5":
            from robustlab.files.hdf5_reader import read_hdf5

            tree = read_hdf5(path, limits, group or None, shown)
        else:
            from robustlab.files.matlab import read_matlab5

            tree = read_matlab5(path, limits, shown)
    except InputError as error:
        send_error(answer, error)
        return 0
    except MemoryError:
        send_error(answer, InputError(shown, "needs more memory than the reader may use"))
        return 0
    send_tree(answer, tree)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
