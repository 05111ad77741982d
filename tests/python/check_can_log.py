"""Checks a CAN log of gapwatch with tools that share no code with it.

Every frame is decoded by cantools (strict database), packed again, which must give the same
bytes, and its CRC is checked by the package autosar-e2e (profile 11, data id mode BOTH). The
counter of each message must step by 1 modulo 15, time must not go backwards, and the frames of
a message must keep the cycle time and the minimum gap that the DBC file states. GapVersion must name
the version of the DBC file and, with --reference FILE, this reference.

Prints one JSON object: {"frames": n, "status_frames": n, "health_frames": n, "version_frames": n,
"states": [[t_s, "Ok"], ...]}, a state for each change. Exit code 1 with one line that names the
first faulty line of the log; 2 when a file cannot be read.

Needs: pip install cantools autosar-e2e
"""

import argparse
import hashlib
import json
import re
import sys
from decimal import Decimal

import cantools
from e2e.p11 import E2E_P11_DATAID_BOTH, e2e_p11_check

# A second sign and a digit of flags: a frame of CAN FD.
LINE = re.compile(r"\((\d{10}\.\d{6})\) (\S+) ([0-9A-F]{3})#(?:#[0-9A-F])?((?:[0-9A-F]{2})+)\n")
COUNTERS = 15
CYCLIC = ("Cyclic", "CyclicAndEvent")


class Fault(Exception):
    """What is wrong with a line of the log."""


def attribute_s(message, name):
    """A time in ms from the attributes of the DBC file, in seconds; None where not stated."""
    attribute = message.dbc.attributes.get(name)
    return Decimal(attribute.value) / 1000 if attribute else None


class MessageCheck:
    """Follows the frames of one message."""

    def __init__(self, message, tolerance_s):
        self.message = message
        self.data_id = message.dbc.attributes["E2EDataId"].value
        cyclic = message.send_type in CYCLIC
        period_s = attribute_s(message, "GenMsgCycleTime") if cyclic else None
        gap_s = attribute_s(message, "GenMsgDelayTime")
        self.longest_s = None if period_s is None else period_s + tolerance_s
        self.shortest_s = None if gap_s is None else gap_s - tolerance_s
        self.frames = 0
        self.last_s = None
        self.last_counter = None

    def check(self, time_s, data):
        """Checks one frame and returns its signals; raises Fault."""
        name = self.message.name
        if not e2e_p11_check(bytearray(data), self.data_id, data_id_mode=E2E_P11_DATAID_BOTH):
            raise Fault(f"{name}: wrong CRC")
        try:
            signals = self.message.decode(data)
            packed = self.message.encode(signals, strict=True)
        except (cantools.Error, ValueError) as error:
            raise Fault(f"{name}: {error}") from error
        if packed != data:
            raise Fault(f"{name}: bits are set that belong to no signal")
        for coded in ("State", "Reason", "Cause"):
            if isinstance(signals.get(coded), int):
                raise Fault(f"{name}: {coded} has the code {signals[coded]}, which has no name")

        counter = signals["Counter"]
        if self.last_counter is not None and counter != (self.last_counter + 1) % COUNTERS:
            raise Fault(f"{name}: counter {counter} after {self.last_counter}")
        if self.last_s is not None:
            self.check_spacing(time_s)
        self.last_counter, self.last_s = counter, time_s
        self.frames += 1
        return signals

    def check_spacing(self, time_s):
        """Checks the time since the frame before; raises Fault."""
        spacing_s = time_s - self.last_s
        if self.longest_s is not None and spacing_s > self.longest_s:
            raise Fault(f"{self.message.name}: {spacing_s} s after the one before, too late")
        if self.shortest_s is not None and spacing_s < self.shortest_s:
            raise Fault(f"{self.message.name}: {spacing_s} s after the one before, too early")

    def check_end(self, end_s):
        """Checks that the message did not fall silent before the end of the log; raises Fault."""
        if self.last_s is None or self.longest_s is None:
            return
        silence_s = end_s - self.last_s
        if silence_s > self.longest_s:
            raise Fault(f"{self.message.name}: silent for the last {silence_s} s")


def check_version(signals, version, reference):
    """Checks which version and which reference a GapVersion names; raises Fault."""
    if str(signals["DbcVersion"]) != version:
        raise Fault(f"GapVersion: version {signals['DbcVersion']}, but the DBC file has {version}")
    named = f"{signals['ReferenceId']:08x}"
    if reference is not None and not reference.startswith(named):
        raise Fault(f"GapVersion: reference {named}, but the file's SHA-256 is {reference}")


def check_log(lines, checks, version, reference):
    """Checks all lines; returns the summary and raises Fault with the line number."""
    states = []
    number, last_s = 0, Decimal(0)
    try:
        for number, line in enumerate(lines, start=1):
            match = LINE.fullmatch(line)
            if match is None:
                raise Fault(f"not a candump line: {line.rstrip()!r}")
            time_s, frame_id = Decimal(match[1]), int(match[3], 16)
            if time_s < last_s:
                raise Fault(f"time goes backwards, from {last_s} s to {time_s} s")
            last_s = time_s
            if frame_id not in checks:
                raise Fault(f"id {frame_id:#x} is not in the DBC file")
            signals = checks[frame_id].check(time_s, bytes.fromhex(match[4]))
            if checks[frame_id].message.name == "GapVersion":
                check_version(signals, version, reference)
            if checks[frame_id].message.name == "GapStatus":
                state = str(signals["State"])
                if not states or states[-1][1] != state:
                    states.append([float(time_s), state])
        if number == 0:
            raise Fault("the log is empty")
        for check in checks.values():
            check.check_end(last_s)
    except Fault as fault:
        raise Fault(f"line {number}: {fault}") from fault

    frames = {check.message.name: check.frames for check in checks.values()}
    return {
        "frames": sum(frames.values()),
        "status_frames": frames["GapStatus"],
        "health_frames": frames["GapHealth"],
        "version_frames": frames["GapVersion"],
        "states": states,
    }


def main():
    """Reads the command line, checks, prints; returns the exit code."""
    parser = argparse.ArgumentParser(
        description="Checks a CAN log of gapwatch frame by frame against its DBC file.",
        epilog="example: check_can_log.py drive.log src/can/gapwatch.dbc",
    )
    parser.add_argument("log", metavar="LOGFILE", help="log in candump format")
    parser.add_argument("dbc", metavar="DBCFILE", help="src/can/gapwatch.dbc")
    parser.add_argument(
        "--tolerance-ms",
        type=Decimal,
        default=Decimal(1),
        help="allowed deviation from cycle time and minimum gap (default: %(default)s)",
    )
    parser.add_argument("--reference", metavar="FILE", help="the reference that was in use")
    arguments = parser.parse_args()
    try:
        database = cantools.database.load_file(arguments.dbc, strict=True)
        with open(arguments.log, encoding="ascii", newline="") as log:
            lines = list(log)
        reference = None
        if arguments.reference is not None:
            # What sha256sum prints for the file.
            with open(arguments.reference, "rb") as file:
                reference = hashlib.sha256(file.read()).hexdigest()
    except (OSError, ValueError, cantools.Error) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    tolerance_s = arguments.tolerance_ms / 1000
    checks = {m.frame_id: MessageCheck(m, tolerance_s) for m in database.messages}
    try:
        print(json.dumps(check_log(lines, checks, database.version, reference)))
    except Fault as fault:
        print(f"{arguments.log}: {fault}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
