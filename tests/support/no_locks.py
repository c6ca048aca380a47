"""Run programs as on a file system without locks: the kernel answers each flock as such a file system does."""

import ctypes
import os
import struct
import subprocess
import sys

import pytest

FLOCK = {"x86_64": 73, "aarch64": 32}  # the number of the system call
NO_NEW_PRIVS, SET_SECCOMP, FILTER = 38, 22, 2  # linux/prctl.h, linux/seccomp.h
LOAD, EQUAL, RETURN = 0x20, 0x15, 0x06  # linux/bpf_common.h
ERROR, ALLOW = 0x00050000, 0x7FFF0000


def without_locks(number: int, *words) -> subprocess.CompletedProcess:
    """Run a program whose flock fails with errno `number`; skip the test if the kernel does not support this."""
    if os.uname().machine not in FLOCK:
        pytest.skip(f"number of flock on {os.uname().machine} is not known")
    command = [sys.executable, "-m", "tests.support.no_locks", str(number), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 77:
        pytest.skip("the kernel takes no filter of system calls here")
    return done


def main(number: int, words: list[str]) -> None:
    """Let the kernel refuse flock, then execute the program."""
    lines = [
        (LOAD, 0, 0, 0),
        (EQUAL, 0, 1, FLOCK[os.uname().machine]),
        (RETURN, 0, 0, ERROR | number),
        (RETURN, 0, 0, ALLOW),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *line) for line in lines))
    program = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(lines), ctypes.addressof(code)))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(NO_NEW_PRIVS, 1, 0, 0, 0) or libc.prctl(SET_SECCOMP, FILTER, ctypes.byref(program), 0, 0):
        sys.exit(77)
    os.execvp(words[0], words)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
