"""Contains a worker process: it cannot write, execute, connect, or reach other processes.

Linux has three layers, and each layer works without the others:

- Landlock limits file access to reading in stated folders, and (new kernels) forbids connections
  and signals to other processes.
- A seccomp filter permits only the system calls that reading files and computing need.  Without
  Landlock it still forbids writing, because files can be opened only for reading.
- Resource limits forbid files with content, child processes and core dumps, and limit memory.

Other systems have only the resource limits that their Python module ``resource`` has.  The module
imports only the standard library, because worker processes import it.
"""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import struct
import sys
from collections.abc import Iterable

# System calls of Landlock; the numbers are the same on all architectures (Linux 5.13).
_LANDLOCK_CREATE_RULESET = 444
_LANDLOCK_ADD_RULE = 445
_LANDLOCK_RESTRICT_SELF = 446
_RULESET_VERSION = 1  # flag that asks for the version of Landlock
_RULE_PATH_BENEATH = 1
_READ_FILE, _READ_DIR = 1 << 2, 1 << 3
# Number of file access rights by the version of Landlock, from the kernel's `landlock.h`.
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
_NET_RIGHTS = 0b11  # bind and connect of TCP, version 4
_SCOPES = 0b11  # abstract Unix sockets and signals, version 6

_PR_SET_PDEATHSIG = 1
_PR_SET_DUMPABLE = 4
_PR_SET_SECCOMP = 22
_PR_SET_NO_NEW_PRIVS = 38
_SECCOMP_MODE_FILTER = 2

# Numbers of the permitted system calls: name -> (x86_64, aarch64), from the tables of the kernel.
_NONE = -1
_PERMITTED = {
    "read": (0, 63),
    "write": (1, 64),
    "close": (3, 57),
    "stat": (4, _NONE),
    "fstat": (5, 80),
    "lstat": (6, _NONE),
    "poll": (7, _NONE),
    "lseek": (8, 62),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "munmap": (11, 215),
    "brk": (12, 214),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "pread64": (17, 67),
    "readv": (19, 65),
    "writev": (20, 66),
    "access": (21, _NONE),
    "sched_yield": (24, 124),
    "mremap": (25, 216),
    "madvise": (28, 233),
    "getpid": (39, 172),
    "exit": (60, 93),
    "uname": (63, 160),
    "getcwd": (79, 17),
    "chdir": (80, 49),
    "readlink": (89, _NONE),
    "gettimeofday": (96, 169),
    "getrusage": (98, 165),
    "times": (100, 153),
    "sigaltstack": (131, 132),
    "gettid": (186, 178),
    "futex": (202, 98),
    "getdents64": (217, 61),
    "restart_syscall": (219, 128),
    "clock_gettime": (228, 113),
    "clock_getres": (229, 114),
    "exit_group": (231, 94),
    "newfstatat": (262, 79),
    "readlinkat": (267, 78),
    "faccessat": (269, 48),
    "ppoll": (271, 73),
    "set_robust_list": (273, 99),
    "getrandom": (318, 278),
    "membarrier": (324, 283),
    "statx": (332, 291),
    "rseq": (334, 293),
    "faccessat2": (439, 439),
}
_OPEN = {"open": (2, _NONE, 1), "openat": (257, 56, 2)}  # with the index of the flags
_OWN_LIMITS = (302, 261)  # prlimit64 of the process itself
_FCNTL = (72, 25)
_FCNTL_COMMANDS = (1, 3)  # F_GETFD and F_GETFL; others duplicate descriptors or lock files
_ARCHITECTURES = {"x86_64": (0, 0xC000003E), "aarch64": (1, 0xC00000B7)}
_WRITE_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
# Codes of the BPF instructions, and results of a filter.
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW, _REFUSE, _KILL = 0x7FFF0000, 0x00050001, 0x80000000  # refuse: EPERM


def contain(folders: Iterable[str], memory_bytes: int) -> dict[str, str]:
    """Contains this process for the rest of its life.

    Returns for each layer (``limits``, ``landlock``, ``seccomp``) an empty text if it is in force,
    or the reason why it is not.  The process must have imported all modules before.

    - ``folders``: folders (or files) that the process may read.
    - ``memory_bytes``: limit of the address space (bytes).
    """
    layers = {"limits": set_limits(memory_bytes)}
    if sys.platform != "linux":
        return layers | dict.fromkeys(("landlock", "seccomp"), f"{sys.platform} has none")
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0)
    if libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        reason = f"no_new_privs: {os.strerror(ctypes.get_errno())}"
        return layers | {"landlock": reason, "seccomp": reason}
    try:
        layers["landlock"] = _restrict_files(libc, folders)
    except OSError as error:
        layers["landlock"] = str(error)
    try:
        layers["seccomp"] = _filter_calls(libc)
    except OSError as error:
        layers["seccomp"] = str(error)
    return layers


def end_with_parent(parent: int) -> None:
    """Ends this process with SIGKILL when its parent process ends, whatever ends the parent.

    Only Linux has this.  On other systems, the process ends when it reads the end of its input, or
    at its limit of processor time.

    - ``parent``: id of the parent process, which may have ended before this call.
    """
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


def set_limits(memory_bytes: int) -> str:
    """Limits the memory, files and child processes of this process.

    Returns an empty text, or the reason why a limit is not in force.
    """
    try:
        import resource
    except ImportError:
        return "this system has no resource limits"
    missing = []
    for name, value in (
        ("RLIMIT_AS", memory_bytes),
        ("RLIMIT_FSIZE", 0),  # the process cannot write to files
        ("RLIMIT_CORE", 0),
        ("RLIMIT_NOFILE", 128),
        ("RLIMIT_NPROC", 0),
    ):
        try:
            resource.setrlimit(getattr(resource, name), (value, value))
        except (AttributeError, ValueError, OSError):
            missing.append(name)
    return f"not supported: {', '.join(missing)}" if missing else ""


def limit_processor_time(seconds: int) -> None:
    """Ends this process with the signal SIGXCPU after more processor time (s) from now on."""
    try:
        import resource

        hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
        limit = int(os.times().user + os.times().system) + seconds
        resource.setrlimit(resource.RLIMIT_CPU, (limit, hard))
    except (ImportError, ValueError, OSError):
        return


def _restrict_files(libc: ctypes.CDLL, folders: Iterable[str]) -> str:
    """Restricts the process to reading in the folders with Landlock."""

    def call(number: int, *arguments: object) -> int:
        result: int = libc.syscall(ctypes.c_long(number), *arguments)
        if result < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        return result

    version = call(_LANDLOCK_CREATE_RULESET, None, ctypes.c_size_t(0), _RULESET_VERSION)
    rights = (1 << _FILE_RIGHTS[min(version, max(_FILE_RIGHTS))]) - 1
    fields = [rights, _NET_RIGHTS if version >= 4 else 0, _SCOPES if version >= 6 else 0]
    ruleset = struct.pack("=3Q", *fields)[: 8 if version < 4 else 16 if version < 6 else 24]
    descriptor = call(_LANDLOCK_CREATE_RULESET, ruleset, ctypes.c_size_t(len(ruleset)), 0)
    for folder in folders:
        try:
            path = os.open(folder, os.O_PATH | os.O_CLOEXEC)
        except OSError:
            continue  # the folder does not exist: there is nothing to read
        allowed = _READ_FILE | _READ_DIR if os.path.isdir(folder) else _READ_FILE
        rule = struct.pack("=Qi", allowed, path)
        call(_LANDLOCK_ADD_RULE, descriptor, _RULE_PATH_BENEATH, rule, 0)
        os.close(path)
    call(_LANDLOCK_RESTRICT_SELF, descriptor, 0)
    os.close(descriptor)
    return ""


def _filter_calls(libc: ctypes.CDLL) -> str:
    """Permits only the system calls of ``_PERMITTED``, with a seccomp filter."""
    machine = platform.machine()
    if machine not in _ARCHITECTURES or struct.calcsize("P") != 8:
        return f"no filter for the architecture {machine}"
    column, architecture = _ARCHITECTURES[machine]
    program = _filter_program(column, architecture)
    code = b"".join(struct.pack("=HBBI", *instruction) for instruction in program)
    buffer = ctypes.create_string_buffer(code, len(code))
    header = struct.pack("@HP", len(program), ctypes.addressof(buffer))
    if libc.prctl(_PR_SET_SECCOMP, _SECCOMP_MODE_FILTER, header, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return ""


def _filter_program(column: int, architecture: int) -> list[tuple[int, int, int, int]]:
    """Returns the BPF program of the filter: tuples (code, jump if true, jump if false, value).

    The offsets in the data of a system call are 0 (number), 4 (architecture) and 16 + 8 i (low half
    of the argument i).
    """
    program = [
        (_LOAD, 0, 0, 4),
        (_EQUAL, 1, 0, architecture),
        (_RETURN, 0, 0, _KILL),
        (_LOAD, 0, 0, 0),
        (_AT_LEAST, 0, 1, 0x40000000),  # the calls of x32 have numbers of their own
        (_RETURN, 0, 0, _KILL),
    ]
    for numbers in _PERMITTED.values():
        if numbers[column] != _NONE:
            program += [(_EQUAL, 0, 1, numbers[column]), (_RETURN, 0, 0, _ALLOW)]
    for *opens, flags in _OPEN.values():
        if opens[column] != _NONE:
            program += [
                (_EQUAL, 0, 4, opens[column]),
                (_LOAD, 0, 0, 16 + 8 * flags),
                (_ANY_BIT, 0, 1, _WRITE_FLAGS),
                (_RETURN, 0, 0, _REFUSE),
                (_RETURN, 0, 0, _ALLOW),
            ]
    program += [
        (_EQUAL, 0, 4, _OWN_LIMITS[column]),
        (_LOAD, 0, 0, 16),
        (_EQUAL, 0, 1, 0),
        (_RETURN, 0, 0, _ALLOW),
        (_RETURN, 0, 0, _REFUSE),
        (_EQUAL, 0, 4, _FCNTL[column]),
        (_LOAD, 0, 0, 24),
        *[(_EQUAL, 1 - i, i, command) for i, command in enumerate(_FCNTL_COMMANDS)],
        (_RETURN, 0, 0, _ALLOW),
        (_RETURN, 0, 0, _REFUSE),  # the result for all other system calls too
    ]
    return program
