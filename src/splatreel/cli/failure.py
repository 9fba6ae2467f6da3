"""Ends of commands that did not succeed: messages for errors, and the exit after Ctrl-C or SIGTERM."""

from __future__ import annotations

import errno
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from splatreel.base.command_line import missing_package, quoted
from splatreel.base.errors import SplatreelError
from splatreel.base.process import address_space_limit

ADVICE = {
    "--width": "smaller images (--width)",
    "--frames": "fewer frames (--frames)",
    "--quality": "--quality draft",
    "--device": "--device cpu",
}
"""Advice that saves memory, by option."""
LIGHTER = {
    **dict.fromkeys(("reconstruct", "demo"), ("--width", "--frames", "--quality", "--device")),
    **dict.fromkeys(("evaluate", "export"), ("--width", "--frames")),
    "view": ("--width",),
}
"""Options of each verb that save memory."""

_ADDRESSES = "the limit of virtual memory of {:,.0f} MB is too low. Raise it (ulimit -v unlimited; in a batch system, the job's memory)"

INTERRUPTED, TERMINATED = 130, 143
"""Exit codes that shells use for a program ended by Ctrl-C, and by SIGTERM."""
AGAIN = 0.05
"""Seconds after which a signal is sent again that arrived while kernels were compiled or loaded."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, from `kill`, a batch system out of time, or a container that stops. It is handled like Ctrl-C."""


@contextmanager
def termination() -> Iterator[None]:
    """Raise `Terminated` on SIGTERM, so that open files are closed. This works in the main thread only.

    While kernels are compiled or loaded, SIGTERM and Ctrl-C raise nothing until this is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    kinds: dict[int, type[KeyboardInterrupt]] = {signal.SIGTERM: Terminated}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        kinds[signal.SIGINT] = KeyboardInterrupt

    def end(number: int, frame: FrameType | None) -> None:
        if _in_compiler(frame):
            again = threading.Timer(AGAIN, signal.pthread_kill, [threading.main_thread().ident, number])
            again.daemon = True
            again.start()
            return
        raise kinds[number]

    before = {number: signal.signal(number, end) for number in kinds}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _in_compiler(frame: FrameType | None) -> bool:
    """Return True if a frame was called by LLVM's binding or compiled code, which would drop an exception."""
    while frame is not None:
        file = frame.f_code.co_filename.replace("\\", "/")
        if "llvmlite" in file or file.endswith("numba/core/serialize.py"):
            return os.name == "posix"
        frame = frame.f_back
    return False


def explain(error: BaseException, arguments: Sequence[str]) -> tuple[str, int] | None:
    """Return the text for standard error and the exit code; None for an unexpected error, which deserves a traceback."""
    command = quoted(["splatreel", *arguments])
    if (interrupt := _interrupt(error)) is not None:
        return interruption(signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT, arguments)
    if (limit := _system_limit(error)) is not None:
        return f"Error: {limit}, then run\n  {command}", 1
    if (full := _full_disk(error)) is not None:
        return f"Error: {_disk_text(error, full)}, then run\n  {command}", 1
    if isinstance(error, SplatreelError):
        return f"Error: {error}", error.exit_code
    if _is_out_of_memory(error):
        if "CUDA" not in str(error) and (limit := address_space_limit()) is not None:
            return f"Error: {_ADDRESSES.format(limit / 1e6)}, then run\n  {command}", 1
        gpu = "CUDA" in str(error)
        return f"Error: out of {'GPU ' if gpu else ''}memory. {_lighter(arguments, gpu)}", 1
    if (folder := _damaged_cache(error)) is not None:
        return (
            f"Error: the compiled code in {folder} is damaged. Delete this folder, which is created again; then run\n  {command}",
            1,
        )
    if isinstance(error, ModuleNotFoundError) and (message := missing_package(error.name)) is not None:
        return f"Error: {message}", 1
    if isinstance(error, FileNotFoundError) and error.filename is None and not _has_current_folder():
        return f"Error: the current folder has been deleted. Change to another folder, then run\n  {command}", 1
    if isinstance(error, UnicodeEncodeError) and any(0xDC80 <= ord(c) <= 0xDCFF for c in error.object):
        return "Error: a name of a file or folder is not UTF-8. Rename it, then run the command again.", 1
    if isinstance(error, OSError) and error.filename is not None:
        return f"Error: {error.filename}: {error.strerror}.", 1
    return None


def _has_current_folder() -> bool:
    """Return False if the folder in which the command runs has been deleted."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def interruption(number: int, arguments: Sequence[str]) -> tuple[str, int]:
    """Return the text and the exit code after a signal."""
    command = quoted(["splatreel", *arguments])
    code = TERMINATED if number == signal.SIGTERM else INTERRUPTED
    return f"Interrupted. Finished parts are kept; continue with the same command:\n  {command}", code


def _lighter(arguments: Sequence[str], gpu: bool) -> str:
    """Return advice that saves memory, by the options of the verb."""
    names = LIGHTER.get(" ".join(arguments[:1]), ())
    ways = [ADVICE[name] for name in names if gpu or name != "--device"]
    if not ways:
        return "Close other programs, or use a machine with more."
    return f"Ask for {', '.join(ways[:-1])}{' or ' if ways[1:] else ''}{ways[-1]}."


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error, and what caused it."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _interrupt(error: BaseException) -> KeyboardInterrupt | None:
    """Return the interruption that caused an error: native code and imports turn interruptions into errors of their own."""
    return next((cause for cause in _causes(error) if isinstance(cause, KeyboardInterrupt)), None)


def _system_limit(error: BaseException) -> str | None:
    """Return the limit of the system that caused an error, with a remedy; None for other errors."""
    for found in _causes(error):
        if isinstance(found, OSError) and found.errno in (errno.EMFILE, errno.ENFILE):
            where = f"{found.filename}: cannot be opened, as " if found.filename else ""
            return f"{where}this process cannot open more files. Raise the limit (ulimit -n 1024)"
        if isinstance(found, RuntimeError) and "can't start new thread" in str(found):
            if (limit := address_space_limit()) is not None:
                return _ADDRESSES.format(limit / 1e6)
            return "the system starts no more threads. Raise the limit of processes (ulimit -u)"
    return None


def _damaged_cache(error: BaseException) -> str | None:
    """Return the folder of numba's cache if a file of it could not be read for what it contains."""
    trace, folder = error.__traceback__, None
    if isinstance(error, RecursionError):  # the call stack was deep already
        return None
    while trace is not None:
        frame = trace.tb_frame
        reads = frame.f_code.co_name.lstrip("_").startswith("load")
        if reads and frame.f_code.co_filename.replace("\\", "/").endswith("numba/core/caching.py"):
            folder = getattr(frame.f_locals.get("self"), "_cache_path", folder)
        trace = trace.tb_next
    return folder


def _full_disk(error: BaseException) -> BaseException | None:
    """Return the error of a full disk that caused an error, also where a library turned it into its own."""
    signs = ("No space left on device", "os error 28")
    for cause in _causes(error):
        full = isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)
        own = isinstance(cause, Exception) and not isinstance(cause, SplatreelError)
        if full or _is_too_large(cause) or (own and any(sign in str(cause) for sign in signs)):
            return cause
    return None


def _disk_text(error: BaseException, full: BaseException) -> str:
    """Return what a full disk stopped, and the remedy."""
    what, remedy = "the disk is full", "free some space"
    if _is_too_large(full):
        what, remedy = "a file would be larger than the system allows", "raise the limit (ulimit -f)"
    if isinstance(error, SplatreelError):
        return f"{what}. {error} Finished parts are kept; {remedy}"
    where = getattr(full, "filename", None)
    return f"{what}{f' while writing {where}' if where else ''}. Finished parts are kept; {remedy}"


def _is_too_large(error: BaseException) -> bool:
    """Return True if a file exceeds the size limit that batch systems set."""
    return isinstance(error, OSError) and error.errno == errno.EFBIG


def _is_out_of_memory(error: BaseException) -> bool:
    """Return True for errors of Python, the system, PyTorch (gsplat), and libraries that cannot be loaded."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    signs = ("can't allocate memory", "not enough memory", "CUDA out of memory", "annot allocate memory")
    signs += ("failed to map segment",)
    if isinstance(error, RuntimeError | ImportError | OSError) and any(sign in str(error) for sign in signs):
        return True
    return error.__context__ is not None and _is_out_of_memory(error.__context__)


GRACE = 3.0
"""Seconds that a command gets to end by itself."""
_END = b"\0"
"""Byte written after the last signal that counts. No signal has this number."""


@contextmanager
def deadline(say: Callable[[int], tuple[str, int]], lasting: bool) -> Iterator[None]:
    """Exit the process `GRACE` seconds after a signal that arrives in the block.

    Args:
        say: Takes the number of the signal. Returns the text for standard error, and the exit code.
        lasting: True if the process ends with this block. Threads that are still busy then must not delay it.
    """
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    read, write = os.pipe()
    os.set_blocking(write, False)
    watch = _Watch(read, say)
    try:
        watch.start()
    except RuntimeError:  # the system starts no more threads; the command may still work without
        os.close(read)
        os.close(write)
        yield
        return
    before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before, warn_on_full_buffer=False)
        if not lasting:
            watch.ended.set()
        os.write(write, _END)  # after the signals that arrived before
        if not lasting:
            watch.join()
            os.close(read)
            os.close(write)


class _Watch(threading.Thread):
    """Thread that waits for the bytes that the interpreter writes when a signal arrives, without a turn of the main thread."""

    def __init__(self, read: int, say: Callable[[int], tuple[str, int]]) -> None:
        super().__init__(name="splatreel deadline", daemon=True)
        self.read = read
        self.say = say
        self.ended = threading.Event()

    def run(self) -> None:
        """Wait for a signal, then exit after the grace period. Leave signals to the main thread, which can hold them."""
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        while True:
            for number in os.read(self.read, 64):
                if number in (signal.SIGINT, signal.SIGTERM):
                    self._exit_later(number)
                    return
                if number == _END[0]:
                    return

    def _exit_later(self, number: int) -> None:
        if self.ended.wait(GRACE):
            return
        text, code = self.say(number)
        os.write(2, f"{text}\n".encode())
        os._exit(code)
