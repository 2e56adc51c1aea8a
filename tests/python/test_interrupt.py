"""Ctrl-C and progress: long work can be watched and stopped."""

import contextlib
import os
import signal
import struct
import subprocess
import sys
import textwrap
import time
from itertools import pairwise

import pytest

import radiosity as rad


def test_progress_reports_rise_to_the_total():
    seen = []
    rad.form_factors(rad.scenes.cornell_box(max_edge=0.2), progress=lambda done, total: seen.append((done, total)))
    assert seen[-1][0] == seen[-1][1] > 0
    assert all(a[0] <= b[0] for a, b in pairwise(seen))


def test_an_exception_in_the_callback_stops_the_work_and_is_passed_on():
    def refuse(done, total):
        raise RuntimeError("stop it")

    with pytest.raises(RuntimeError, match="stop it"):
        rad.form_factors(rad.scenes.cornell_box(max_edge=0.05), tolerance=1e-3, progress=refuse)
    # Nothing is left broken behind.
    assert rad.form_factors(rad.scenes.furnace()).shape == (12, 12)


def test_progress_must_be_one_of_its_kinds():
    with pytest.raises(TypeError, match="progress must be True, False or a callable"):
        rad.form_factors(rad.scenes.furnace(), progress="bar")


LONG_WORK = {
    "rays": "rad.solve(rad.scenes.cornell_box(max_edge=0.02), tolerance=0.001)",
    "form factors": "rad.form_factors(rad.scenes.cornell_box(max_edge=0.02), tolerance=1e-4)",
    # The library's factorisation cannot be told to stop: the caller must not wait for it.
    "direct": "rad.solve_system(np.full((6000, 6000), 1 / 6000), 1.0, 0.9, method='direct')",
    "southwell": "rad.solve_system(np.full((3000, 3000), 1 / 3000), 1.0, 0.9999, method='southwell', tolerance=1e-12)",
}


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent by the POSIX way")
@pytest.mark.parametrize("work", LONG_WORK)
def test_ctrl_c_raises_keyboard_interrupt_within_a_second(work):
    program = f"""
        import time
        import numpy as np
        import radiosity as rad
        print("ready", flush=True)
        try:
            {LONG_WORK[work]}
        except KeyboardInterrupt:
            print(time.time(), flush=True)
            raise SystemExit(0)
        raise SystemExit("the work ended by itself")
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    # Into the middle of the work: the slowest of these takes half a second to build its input.
    time.sleep(2.0)
    sent = time.time()
    process.send_signal(signal.SIGINT)
    raised = process.stdout.readline()
    process.kill()
    _, errors = process.communicate()
    assert raised, errors
    assert float(raised) - sent < 1.0


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_progress_bar_shows_in_a_terminal_and_nowhere_else():
    import fcntl
    import pty
    import termios

    program = "import radiosity as rad; rad.form_factors(rad.scenes.cornell_box(max_edge=0.06), tolerance=1e-2)"
    main, terminal = pty.openpty()
    # 24 rows of 80 columns: a terminal without a size shows no bar.
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    process = subprocess.Popen([sys.executable, "-c", program], stderr=terminal)
    os.close(terminal)
    shown = b""
    # Reading fails once the process has ended and the terminal is gone.
    with contextlib.suppress(OSError):
        while b"%|" not in shown:
            shown += os.read(main, 4096)
    process.kill()
    process.wait()
    os.close(main)
    assert b"form factors:" in shown
    assert b"%|" in shown
    quiet = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True, timeout=300)
    assert quiet.stderr == b""
