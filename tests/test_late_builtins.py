"""Warp's functions give the same results in Python and in kernels if their variants are late."""

import sys

from support.processes import run_program

PROGRAM = """
import sys
from phy124.runtime.late_builtins import declare_late
if sys.argv[1] == "late":
    declare_late()
import warp as wp
from warp._src.context import builtin_functions
wp.config.log_level = wp.LOG_ERROR
wp.init()
print(sum(len(getattr(each, 'overloads', ())) for each in builtin_functions.values()))
v = wp.vec3(1.0, 2.0, 3.0)
turn = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), 0.5)
print(2.0 * v + v, -v, wp.dot(v, v), wp.normalize(wp.vec3d(1.0, 2.0, 2.0)), wp.max(1, 2))
print(wp.quat_rotate(turn, v), wp.mat22(1.0, 2.0, 3.0, 4.0) @ wp.vec2(1.0, 1.0))
try:
    wp.dot(v, 1.0)
except Exception as error:
    print(type(error).__name__, error)
"""


def test_late_variants_give_the_same_results() -> None:
    usual, late = (
        run_program([sys.executable, "-c", PROGRAM, mode], check=True).stdout.splitlines()
        for mode in ("usual", "late")
    )
    assert int(late[0]) < int(usual[0]) / 2
    assert late[1:] == usual[1:]


THREADS = """
import sys, threading
from phy124.runtime.late_builtins import declare_late
declare_late()
import warp as wp
wp.config.log_level = wp.LOG_ERROR
wp.init()
sys.setswitchinterval(1e-6)
v = wp.vec3(1.0, 2.0, 2.0)
start, done = threading.Barrier(4), []
def call(function, *arguments):
    start.wait()
    function(*arguments)
    done.append(function)
for call_of in ((wp.mul, 2.0, v), (wp.add, v, v), (wp.sub, v, v), (wp.dot, v, v), (wp.length, v)):
    threads = [threading.Thread(target=call, args=call_of) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
print(len(done))
"""


def test_threads_that_call_a_function_first_at_once() -> None:
    run = run_program([sys.executable, "-c", THREADS], check=True)
    assert run.stdout.strip() == "20", run.stderr
