"""The memory of a node of hours: one heap for all threads."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Threads allocate at the same time, so that glibc gives them heaps of their own if it may.
ALLOCATE = """
import ctypes, sys, threading
libc = ctypes.CDLL(None)
if not hasattr(libc, "malloc_info"):
    sys.exit("no glibc")
if sys.argv[1] == "one":
    from trajeval_ros.ros.lifetime import use_one_heap
    use_one_heap()
libc.malloc.restype, libc.fdopen.restype = ctypes.c_void_p, ctypes.c_void_p
ready = threading.Barrier(4)
def allocate():
    ready.wait()
    for _ in range(1000):
        libc.malloc(5000)
    ready.wait()
threads = [threading.Thread(target=allocate) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
libc.malloc_info(0, ctypes.c_void_p(libc.fdopen(1, b"w")))
libc.fflush(None)
"""


@pytest.mark.parametrize("heaps", ["one", "default"])
def test_threads_share_one_heap(heaps: str) -> None:
    command = [sys.executable, "-c", ALLOCATE, heaps]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.stderr == "no glibc\n":
        pytest.skip("another C library")
    assert result.returncode == 0, result.stderr
    count = result.stdout.count("<heap nr=")
    assert (count == 1) if heaps == "one" else (count > 1)
