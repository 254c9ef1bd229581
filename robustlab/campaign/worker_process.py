"""A local worker: ``python -m robustlab.campaign.worker_process``, started by `robustlab.campaign.workers`.

It takes frames (8 bytes of length, then the content) from stdin and answers in frames on stdout: the payload first,
which it answers with an empty frame, then one request after the other. It ends when stdin does.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from typing import BinaryIO

LENGTH = 8


def read_frame(stream: BinaryIO) -> bytes | None:
    """The next frame, or None at the end of the stream (also in the middle of a frame: the sender was killed)."""
    head = stream.read(LENGTH)
    if len(head) < LENGTH:
        return None
    size = int.from_bytes(head, "little")
    content = stream.read(size)
    return content if len(content) == size else None


def write_frame(stream: BinaryIO, content: bytes) -> None:
    """Send a frame."""
    stream.write(len(content).to_bytes(LENGTH, "little"))
    stream.write(content)
    stream.flush()


def main() -> int:
    """Serve until stdin ends."""
    for number in (signal.SIGINT, signal.SIGTERM):  # they may be sent to the whole group: the parent's to handle
        signal.signal(number, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a native library prints must not get between the frames
    frames: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(frames,), daemon=True).start()

    from robustlab.campaign.evaluation import Payload, evaluator_of, perform

    evaluator = evaluator_of(Payload.from_bytes(frames.get()))
    write_frame(answers, b"")
    while True:
        write_frame(answers, perform(evaluator, json.loads(frames.get())))


def _receive(frames: queue.SimpleQueue[bytes]) -> None:
    """Pass frames on; when the parent is gone, end the process even in the middle of its work."""
    while (frame := read_frame(sys.stdin.buffer)) is not None:
        frames.put(frame)
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
