"""usage: refuse.py WHAT COMMAND..: runs a command to whom the system refuses what some file systems lack. Linux on x86-64."""

import ctypes
import os
import struct
import sys

EPERM, ENODEV, ENOLCK = 1, 19, 37
# Numbers of system calls, and what they fail with.
REFUSED = {"links": ((86, 265), EPERM), "renames": ((82, 264, 316), EPERM), "locks": ((73,), ENOLCK), "maps of files": ((9,), ENODEV)}
# Instructions of a filter: load a word, do these bits of it, is it equal, end.
LOAD, AND, IF, END = 0x20, 0x54, 0x15, 0x06
ALLOW, FAIL = 0x7FFF0000, 0x50000
FLAGS_OF_MMAP = 16 + 8 * 3
SHARED, ANONYMOUS = 1, 0x20

numbers, error = REFUSED[sys.argv[1]]
program = [(LOAD, 0, 0, 0)]
for number in numbers:
    if sys.argv[1] == "maps of files":
        program += [(IF, 0, 4, number), (LOAD, 0, 0, FLAGS_OF_MMAP), (AND, 0, 0, SHARED | ANONYMOUS), (IF, 0, 1, SHARED), (END, 0, 0, FAIL | error)]
    else:
        program += [(IF, 0, 1, number), (END, 0, 0, FAIL | error)]
program.append((END, 0, 0, ALLOW))
code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *instruction) for instruction in program))
filter = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(program), ctypes.addressof(code)))
libc = ctypes.CDLL(None)
PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP, SECCOMP_MODE_FILTER = 38, 22, 2
assert libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 and libc.prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, filter, 0, 0) == 0, "no filters here"
os.execv(sys.argv[2], sys.argv[2:])
