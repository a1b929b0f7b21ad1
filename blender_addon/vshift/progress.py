# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress lines with the time left, and clean interruption. Needs no Blender."""
import os
import shutil
import signal
import sys
import threading
import time


class Interrupted(BaseException):
    """SIGINT or SIGTERM arrived; exit code 130."""


class Progress:
    """Counts items by kind and estimates what is left by the measured seconds of each kind."""

    def __init__(self, todo, stream=None):
        """todo: dict kind -> number of items still to do."""
        self.left = dict(todo)
        self.total = sum(todo.values())
        self.done = 0
        self.spent = {}
        self.stream = stream or sys.stderr

    def add(self, kind, name, seconds):
        self.done += 1
        self.left[kind] = max(0, self.left.get(kind, 0) - 1)
        n, s = self.spent.get(kind, (0, 0.0))
        self.spent[kind] = (n + 1, s + seconds)
        print(f"vshift: {self.done}/{self.total} {name} {seconds:.2f} s, left {self.time_left()}",
              file=self.stream, flush=True)

    def drop(self, kind, name, why):
        """An item that will not be made (refused)."""
        self.left[kind] = max(0, self.left.get(kind, 0) - 1)
        self.total -= 1
        print(f"vshift: {name}: {why}", file=self.stream, flush=True)

    def say(self, text):
        print(f"vshift: {text}", file=self.stream, flush=True)

    def time_left(self):
        """As m:ss, or "?" before anything was measured; kinds not yet met count as the mean of the others."""
        if not self.spent:
            return "?"
        mean = sum(s for _, s in self.spent.values()) / sum(n for n, _ in self.spent.values())
        seconds = sum(n * (self.spent[k][1] / self.spent[k][0] if k in self.spent else mean)
                      for k, n in self.left.items())
        return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


GRACE_S = 3.0
_folders = []
_signals = []


def interrupted_by():
    """Name of the signal that came, or None. A library may turn the exception into an error of its own."""
    return _signals[0] if _signals else None


def guard(folder):
    """Registers a run's folder of unfinished files, removed when a signal has to end the process by force."""
    _folders.append(folder)


def install_signal_handlers():
    """SIGINT and SIGTERM raise Interrupted in the main thread at the next step between items.

    A render runs in C and cannot be broken into: when the main thread does not answer within GRACE_S
    seconds, a helper thread removes the unfinished files and ends the process with 130. Finished files
    are renamed into place whole, so nothing torn is left in either case.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)

    def raise_interrupted(number, _frame):
        _signals.append(signal.Signals(number).name)
        raise Interrupted(_signals[0])

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, raise_interrupted)

    def force():
        os.read(reader, 1)
        time.sleep(GRACE_S)
        for folder in _folders:
            shutil.rmtree(folder, ignore_errors=True)
            try:
                os.rmdir(os.path.dirname(folder))    # stays when another run is at work in it
            except OSError:
                pass
        print("vshift: interrupted; run the same command again to go on", file=sys.stderr, flush=True)
        os._exit(130)

    threading.Thread(target=force, daemon=True).start()
