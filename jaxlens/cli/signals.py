"""Ends the process soon after it is told to, whatever it is at, and leaves nothing half-written.

Python raises for a signal only between two steps of the main thread, and one call into XLA or OpenCV may be minutes
long. So a second thread hears of the signal at once, gives the first some time to unwind, and then undoes what is
unfinished (`jaxlens.files`) and ends the process.
"""

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from typing import NoReturn

from jaxlens.files import undo_unfinished

_ENDING = {getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)}
# Seconds that the main thread has to unwind.
_PATIENCE = 1.0
# A progress bar hides the cursor of a terminal.
_SHOW_CURSOR = b"\x1b[?25h\n"


def obey_signals() -> None:
    """Lets the signals to end raise in the main thread, and end the process a second later whatever happens."""
    for number in _ENDING:
        # A signal that is ignored (nohup) stays so; that of Ctrl-C has a handler of Python's own.
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _raise)
    sys.unraisablehook = _tell_unraisable
    # Sockets, for Windows knows no other.
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    # The sender is the thread's to keep open, too.
    threading.Thread(target=_watch, args=(receiver, sender), daemon=True).start()


def leave(code: int) -> NoReturn:
    """Ends the process now: the interpreter's own end would wait for what XLA still computes."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(code)


def _raise(number: int, _frame: object) -> NoReturn:
    # An exception unwinds, so that temporary files are removed.
    raise SystemExit(128 + number)


def _tell_unraisable(unraisable: "sys.UnraisableHookArgs") -> None:
    # In a finalizer, or a callback of the garbage collector, what the signal raises is lost, and the process ends all
    # the same.
    if not isinstance(unraisable.exc_value, KeyboardInterrupt | SystemExit):
        sys.__unraisablehook__(unraisable)


def _watch(receiver: socket.socket, _sender: socket.socket) -> None:
    number = 0
    while number not in _ENDING:
        number = receiver.recv(1)[0]
    time.sleep(_PATIENCE)
    undo_unfinished()
    with contextlib.suppress(AttributeError, OSError, ValueError):
        if sys.stderr.isatty():
            os.write(sys.stderr.fileno(), _SHOW_CURSOR)
        if number == signal.SIGINT:
            os.write(sys.stderr.fileno(), b"jaxlens: interrupted\n")
    os._exit(128 + number)
