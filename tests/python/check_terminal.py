"""What people see: gapwatch under a pseudo terminal, read by a terminal emulator (pyte).

usage: check_terminal.py GAPWATCH FOLDER
"""

import os
import pty
import re
import select
import subprocess
import sys
import time

import pyte

DRIVE = "scene:sim?seed=7&seconds=4&size=160x80&condition=noise:5@2-4"
BOARD = f'[camera]\nsource = "{DRIVE}"\n[can]\nsink = "none"\n[monitor]\nstrict = true\n'
COLOUR = re.compile(r"\x1b\[[0-9;]*3[1-6]m|\x1b\[3[1-6]m")
LIVE = re.compile(r"(Init|Ok|Suspect|Gap) +([█·]{5}\|[█·]{5} gap +-?\d+\.\d\d|no gap +)(?: +change +-?\d+\.\d\d)?(?: +lanes lost \d+ %)?(?: +[\w-]+ \(\d+ %\))? +(\d+|–) frames/s +\d+ ms old")


def run(args, folder, columns=120, **more):
    """All bytes that a program writes to a terminal, and the screens on the way."""
    master, slave = pty.openpty()
    import fcntl, struct, termios
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    environment = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE")}
    environment |= {"TERM": "xterm-256color", **more}
    child = subprocess.Popen(args, cwd=folder, stdin=slave, stdout=slave, stderr=slave, env=environment)
    os.close(slave)
    screen = pyte.Screen(columns, 40)
    stream = pyte.ByteStream(screen)
    seen, screens, began = b"", [], time.monotonic()
    while True:
        if select.select([master], [], [], 0.05)[0]:
            try:
                data = os.read(master, 65536)
            except OSError:
                break
            if not data:
                break
            seen += data
            stream.feed(data)
            screens.append((time.monotonic() - began, [line.rstrip() for line in screen.display if line.strip()]))
    code = child.wait()
    return code, seen.decode(), screens


def lives(screens):
    """The live lines that were on the screen, each once."""
    found = []
    for at, lines in screens:
        live = [line for line in lines if LIVE.search(line)]
        assert len(live) <= 1, lines
        if live and (not found or found[-1][1] != live[0]):
            found.append((at, live[0]))
    return found


def check_replay(gapwatch, folder):
    args = [gapwatch, "replay", DRIVE, "--speed", "realtime"]
    code, seen, screens = run(args, folder)
    assert code == 0, seen
    shown = lives(screens)
    assert 5 <= len(shown) <= 30, f"{len(shown)} lines in 4 s: {shown}"
    assert any("Ok" in line for _, line in shown) and any("█|█" in line for _, line in shown), shown
    assert all(re.search(r"\d+/40 frames, \d+s left", line) for _, line in shown), shown
    assert COLOUR.search(seen)
    # In the end only lines stay, whole: no rest of the live line.
    last = screens[-1][1]
    assert re.match(r" +0\.0 s  Init +starting$", last[0]), last
    assert all(re.match(r" +\d+\.\d s  \w+ +(starting|gap -?\d+\.\d\d(  change -?\d+\.\d\d)?  lanes lost \d+ %(  [\w-]+(, likely cause: [\w-]+ \(\d+ %\))?)?)$", line) for line in last[:-1]), last
    assert last[-1].startswith("40 frames, 3.9 s of drive"), last

    _, plain, screens = run(args, folder, NO_COLOR="1")
    assert lives(screens) and not COLOUR.search(plain), plain[:400]
    # Narrow: cut, not wrapped.
    _, _, screens = run(args, folder, columns=50)
    assert all(sum("frames/s" in line or "ms old" in line for line in lines) <= 1 for _, lines in screens)
    assert screens[-1][1][-1].startswith("40 frames") or "40 frames" in " ".join(screens[-1][1]), screens[-1]

    code, seen, _ = run([*args, "--quiet"], folder)
    assert (code, seen) == (0, ""), seen
    piped = subprocess.run(args, cwd=folder, capture_output=True, text=True)
    assert "\x1b" not in piped.stdout and piped.stderr == "", piped
    assert "\r" not in piped.stdout and len(piped.stdout.splitlines()) == len(last), piped.stdout


def check_monitor(gapwatch, folder):
    with open(os.path.join(folder, "board.toml"), "w") as file:
        file.write(BOARD)
    args = [gapwatch, "monitor", "--board", "board.toml"]
    code, seen, screens = run(args, folder)
    assert code == 0, seen
    shown = lives(screens)
    assert 5 <= len(shown) <= 30, shown
    assert "Unavailable" in screens[-1][1][-1] and "stopped" in screens[-1][1][-1], screens[-1]
    code, seen, _ = run([*args, "--quiet"], folder)
    assert (code, seen) == (0, ""), seen


def check_progress(gapwatch, folder):
    args = [gapwatch, "calibrate", "--sim", "scene:sim?seed=1..8&seconds=6", "--metric", "log-energy-js", "--out", "reference.json"]
    code, seen, screens = run(args, folder)
    assert code == 0, seen
    # Some steps are over before a screen is read.
    for step in ("looking", "thresholds"):
        assert re.search(rf"{step} [^\r\n]*\d+/\d+ [^\r\n]*, \d+s left", seen), (step, seen[-800:])
    assert not any("left" in line for line in screens[-1][1]), screens[-1]


if __name__ == "__main__":
    check_replay(*sys.argv[1:])
    check_monitor(*sys.argv[1:])
    check_progress(*sys.argv[1:])
    print("the terminal shows what it should")
