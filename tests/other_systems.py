"""Windows and macOS, stood in for on Linux: what they lack is taken from m100link, from it alone.

``python -m tests.other_systems win32 PROGRAM WORDS…`` runs the text of a program so, and ``darwin``
does for macOS. Python itself and other packages keep everything: they know these systems.

What no stand-in shows, and only the system itself does: paths with drives and backslashes, files
that another process has open, timers of 15 ms, COM ports, and how processes end.
"""

from __future__ import annotations

import asyncio
import builtins
import importlib.util
import os
import selectors
import signal
import socket
import stat
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

_TEXT_MODE = 1 << 28  # O_BINARY, which a file has to be opened with there
BREAK = signal.SIGUSR1
"""The signal of Linux that a program finds under the name SIGBREAK."""

MODULES = {
    "win32": {
        *("_posixsubprocess", "crypt", "curses", "fcntl", "grp", "nis", "posix", "pty", "pwd"),
        *("readline", "resource", "spwd", "syslog", "termios", "tty"),
    },
    "darwin": {"spwd"},
}
"""Modules of Python that a system has not."""

_LINUX = {
    "os": {
        *("eventfd", "eventfd_read", "eventfd_write", "fdatasync", "getrandom", "getxattr"),
        *("listxattr", "memfd_create", "pidfd_open", "pipe2", "posix_fadvise", "posix_fallocate"),
        *("removexattr", "sched_getaffinity", "sched_setaffinity", "sched_setscheduler"),
        *("setresuid", "setxattr", "splice", "timerfd_create", "timerfd_settime"),
        *("O_DIRECT", "O_NOATIME", "O_PATH", "O_TMPFILE"),
    },
    "select": {"epoll"},
    "selectors": {"EpollSelector"},
    "signal": {"SIGPOLL", "SIGPWR", "SIGRTMAX", "SIGRTMIN", "SIGSTKFLT", "sigtimedwait"},
    "socket": {
        *("AF_CAN", "AF_NETLINK", "AF_PACKET", "SO_BINDTODEVICE", "SO_PEERCRED", "SOCK_CLOEXEC"),
        *("SOCK_NONBLOCK", "TCP_QUICKACK", "TCP_USER_TIMEOUT"),
    },
    "time": {"CLOCK_BOOTTIME", "CLOCK_TAI"},
}
"""What Python has on Linux, and not on macOS."""

_POSIX = {
    "asyncio": {"open_unix_connection", "start_unix_server"},
    "mmap": {"MAP_ANONYMOUS", "MAP_PRIVATE", "MAP_SHARED", "PROT_READ", "PROT_WRITE"},
    "os": {
        *("chown", "chroot", "confstr", "ctermid", "fchmod", "fchown", "fork", "forkpty"),
        *("getegid", "geteuid", "getgid", "getgroups", "getloadavg", "getpgid", "getpgrp"),
        *("getpriority", "getsid", "getuid", "initgroups", "killpg", "lchown", "major", "minor"),
        *("mkfifo", "mknod", "nice", "openpty", "posix_spawn", "pread", "preadv", "pwrite"),
        *("pwritev", "register_at_fork", "sendfile", "setgid", "setpgid", "setpriority", "setsid"),
        *("setuid", "statvfs", "sync", "sysconf", "tcgetpgrp", "tcsetpgrp", "ttyname", "uname"),
        *("wait", "wait3", "wait4", "waitid", "WNOHANG", "get_blocking", "set_blocking"),
        *("O_ASYNC", "O_CLOEXEC", "O_DIRECTORY", "O_DSYNC", "O_NDELAY", "O_NOCTTY", "O_NOFOLLOW"),
        *("O_NONBLOCK", "O_SYNC"),
    },
    "select": {"poll"},
    "selectors": {"PollSelector"},
    "signal": {
        *("SIGALRM", "SIGBUS", "SIGCHLD", "SIGCONT", "SIGHUP", "SIGIO", "SIGKILL", "SIGPIPE"),
        *("SIGPROF", "SIGQUIT", "SIGSTOP", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGUSR1", "SIGUSR2"),
        *("SIGVTALRM", "SIGWINCH", "SIGXCPU", "SIGXFSZ", "alarm", "getitimer", "pause"),
        *("pthread_kill", "pthread_sigmask", "setitimer", "sigpending", "sigwait"),
    },
    "socket": {
        # SO_REUSEADDR is there, and lets any program take the port of another one.
        *("AF_UNIX", "CMSG_LEN", "SCM_RIGHTS", "SO_REUSEADDR", "SO_REUSEPORT"),
        *("TCP_NOTSENT_LOWAT", "recv_fds", "send_fds"),
    },
    "time": {
        *("CLOCK_MONOTONIC", "CLOCK_MONOTONIC_RAW", "CLOCK_PROCESS_CPUTIME_ID", "CLOCK_REALTIME"),
        *("CLOCK_THREAD_CPUTIME_ID", "clock_getres", "clock_gettime", "clock_gettime_ns"),
        *("clock_settime", "pthread_getcpuclockid", "tzset"),
    },
}
"""What Python has on macOS as well, and not on Windows."""

MISSING: dict[str, dict[str, set[str]]] = {
    "darwin": _LINUX,
    "win32": {name: _LINUX.get(name, set()) | _POSIX.get(name, set()) for name in _LINUX | _POSIX},
}
"""Names that modules of Python lack on a system."""


class _Seen(ModuleType):
    """A module as m100link sees it: some names are missing, and some are others."""

    def __init__(self, real: ModuleType, missing: set[str], instead: Mapping[str, object]) -> None:
        super().__init__(real.__name__)
        vars(self).update(_real=real, _missing=missing, _instead=instead)

    def __getattr__(self, name: str) -> Any:
        if name in self._missing:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        return self._instead[name] if name in self._instead else getattr(self._real, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._real, name, value)

    def __dir__(self) -> list[str]:
        return sorted({*dir(self._real), *self._instead} - self._missing)


def _asks(depth: int = 2) -> bool:
    """Whether m100link called what calls this."""
    return str(sys._getframe(depth).f_globals.get("__name__", "")).startswith("m100link")


def _open(path: Any, flags: int, mode: int = 0o777, **options: Any) -> int:
    """The C library of Windows opens no folder, and gives bytes only with its flag for them."""
    if os.path.isdir(path):
        raise PermissionError(13, "Permission denied", path)
    is_from_python = flags & os.O_CLOEXEC  # that has its own O_BINARY there
    assert flags & _TEXT_MODE or is_from_python or path == os.devnull, f"{path} is opened as text"
    return os.open(path, flags & ~_TEXT_MODE, mode, **options)


def _fstat(handle: int) -> os.stat_result:
    """The state of a file, which everybody may read and write, as far as Windows tells."""
    found: list[Any] = list(os.fstat(handle))
    found[stat.ST_MODE] |= 0o666
    return os.stat_result(found)


def _in_use(real: Callable[..., Any]) -> Callable[..., Any]:
    """Windows moves and removes no file that is open, nor puts another one in its place."""

    def method(self: Path, *others: Any, **options: Any) -> Any:
        if _asks():
            files = [one.stat() for one in Path("/proc/self/fd").iterdir() if one.exists()]
            for path in (self, *map(Path, others)):
                if path.exists() and any(os.path.samestat(path.stat(), one) for one in files):
                    raise PermissionError(13, "Permission denied", str(path))
        return real(self, *others, **options)

    return method


class _Proactor(asyncio.SelectorEventLoop):
    """The usual event loop of Windows: it has processes and pipes, and watches nothing."""


def _without_watching(loop: type[asyncio.BaseEventLoop]) -> None:
    """Let its methods raise for m100link what they raise on Windows."""

    def refusing(real: Callable[..., Any], *, takes_sockets: bool) -> Callable[..., Any]:
        def method(self: asyncio.BaseEventLoop, *arguments: Any, **options: Any) -> Any:
            if _asks():
                line = arguments[0] if takes_sockets and arguments else None
                handle = line if isinstance(line, int) else getattr(line, "fileno", lambda: -1)()
                is_socket = handle >= 0 and stat.S_ISSOCK(os.fstat(handle).st_mode)
                if isinstance(self, _Proactor) or not is_socket:
                    raise NotImplementedError
            return real(self, *arguments, **options)

        return method

    for name in ("add_reader", "add_writer", "remove_reader", "remove_writer"):
        setattr(loop, name, refusing(getattr(loop, name), takes_sockets=True))
    for name in ("add_signal_handler", "create_unix_server", "create_unix_connection"):
        setattr(loop, name, refusing(getattr(loop, name), takes_sockets=False))

    def has_processes(real: Callable[..., Any]) -> Callable[..., Any]:
        def method(self: asyncio.BaseEventLoop, *arguments: Any, **options: Any) -> Any:
            if not isinstance(self, _Proactor):
                raise NotImplementedError
            return real(self, *arguments, **options)

        return method

    for name in ("subprocess_exec", "subprocess_shell", "connect_read_pipe", "connect_write_pipe"):
        setattr(loop, name, has_processes(getattr(loop, name)))


def stand_in(system: str) -> None:
    """From now on this process is that system to m100link, which must not be loaded yet."""
    assert not any(name.startswith("m100link") for name in sys.modules)
    instead: dict[str, dict[str, object]] = {"sys": {"platform": system}}
    if system == "win32":
        instead["os"] = {"name": "nt", "O_BINARY": _TEXT_MODE, "open": _open, "fstat": _fstat}
        instead["signal"] = {"SIGBREAK": BREAK}
        instead["socket"] = {"SO_EXCLUSIVEADDRUSE": socket.SO_REUSEADDR}
        _without_watching(asyncio.SelectorEventLoop)
        for name in ("rename", "replace", "unlink"):
            setattr(Path, name, _in_use(getattr(Path, name)))
        unix_events = vars(importlib.import_module("asyncio.unix_events"))
        unix_events["_UnixDefaultEventLoopPolicy"]._loop_factory = _Proactor  # no public name
    missing = MISSING[system]
    real = {one.__name__: one for one in (asyncio, os, selectors, signal, socket, sys, time)}
    real |= {name: importlib.import_module(name) for name in ("mmap", "select")}
    seen = {
        name: _Seen(one, missing.get(name, set()), instead.get(name, {}))
        for name, one in real.items()
    }
    load, find = builtins.__import__, importlib.util.find_spec

    def imported(
        name: str,
        globals: Mapping[str, object] | None = None,  # noqa: A002
        locals: Mapping[str, object] | None = None,  # noqa: A002
        fromlist: Any = (),
        level: int = 0,
    ) -> Any:
        if level or not str((globals or {}).get("__name__", "")).startswith("m100link"):
            return load(name, globals, locals, fromlist, level)
        if name.partition(".")[0] in MODULES[system]:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        found = load(name, globals, locals, fromlist, level)
        return seen.get(found.__name__, found)

    def spec(name: str, package: str | None = None) -> Any:
        return None if _asks() and name in MODULES[system] else find(name, package)

    builtins.__import__ = imported
    importlib.util.find_spec = spec


if __name__ == "__main__":
    _, kind, program, *words = sys.argv
    sys.argv = ["m100link", *words]
    stand_in(kind)
    exec(compile(program, "<program>", "exec"), {"__name__": "__main__"})
