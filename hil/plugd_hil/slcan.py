"""A serial CAN adapter (slcan, Lawicel's protocol) on a pseudo terminal, and what is at the bus behind it.

plugd opens the terminal as it would an adapter on USB. A thread answers at once, whatever the clock says.
"""

import fcntl
import os
import struct
import termios
import threading
import time
import tty
from collections import deque
from contextlib import suppress
from typing import Protocol

import can

PATIENCE_S = 5.0
UNREAD_BYTES = 3000
"""With so much waiting to be read what comes is lost, as in an adapter whose buffer is full. A terminal takes 4095."""
MOST_BYTES = 64
"""Longer than any line of the protocol."""


class Wire(Protocol):
    """The stub's end of a CAN bus."""

    channel: str
    """What plugd opens."""

    def take(self) -> list[can.Message]:
        """What has arrived."""

    def send(self, messages: list[can.Message]) -> None:
        """Put frames on the bus."""

    def close(self) -> None:
        """Leave it."""


class SlcanWire:
    """The adapter, and the bus behind it."""

    def __init__(self, waits: bool) -> None:
        """`waits`: after sending, until the other side could read it: on a simulated clock it is not running then."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        self.channel = os.ttyname(self._slave)
        self._waits = waits
        self._arrived: deque[can.Message] = deque()
        self._open = False
        self._writing = threading.Lock()
        self._thread = threading.Thread(target=self._serve, name="slcan", daemon=True)
        self._thread.start()

    def take(self) -> list[can.Message]:
        """What has arrived."""
        return [self._arrived.popleft() for _ in range(len(self._arrived))]

    def send(self, messages: list[can.Message]) -> None:
        """To plugd, if it has opened the channel."""
        if self._open and messages:
            self.raw("".join(map(line_of, messages)).encode())

    def raw(self, data: bytes) -> None:
        """Bytes as they are, frames or not."""
        with self._writing:
            before = self._readable()
            if before > UNREAD_BYTES:
                return
            os.write(self._master, data)
            until_s = time.monotonic() + PATIENCE_S
            while self._waits and self._readable() < before + len(data) and time.monotonic() < until_s:
                time.sleep(0)

    def _readable(self) -> int:
        return int(struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0"))[0])

    def _serve(self) -> None:
        line = bytearray()
        with suppress(OSError):
            while data := os.read(self._master, 4096):
                for byte in data:
                    if byte != 0x0D:
                        line = bytearray() if len(line) > MOST_BYTES else line + bytes((byte,))
                        continue
                    answer = self._obey(line.decode("ascii", "replace"))
                    line = bytearray()
                    with self._writing:
                        os.write(self._master, answer)

    def _obey(self, line: str) -> bytes:
        """A line of the protocol."""
        match line[:1]:
            case "O" | "L" | "C":
                self._open = line[0] != "C"
                return b"\r"
            case "S" | "s" | "Z" | "Y":
                return b"\r"
            case "V":
                return b"V1013\r"
            case "N":
                return b"NA123\r"
            case "t" | "T":
                message = message_of(line)
                if message is None or not self._open:
                    return b"\a"
                self._arrived.append(message)
                return b"z\r" if line[0] == "t" else b"Z\r"
            case _:
                return b"\a"

    def close(self) -> None:
        """The cable is pulled."""
        os.close(self._slave)
        os.close(self._master)


class MulticastWire:
    """A bus by UDP multicast that does not leave this machine. `channel` is GROUP:PORT."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        group, _, port = channel.partition(":")
        self._bus = can.Bus(interface="udp_multicast", channel=group, port=int(port), hop_limit=0, fd=False)

    def take(self) -> list[can.Message]:
        """What has arrived, our own frames among it."""
        found = []
        while (message := self._bus.recv(timeout=0)) is not None:
            found.append(message)
        return found

    def send(self, messages: list[can.Message]) -> None:
        """To everybody on the bus."""
        for message in messages:
            self._bus.send(message)

    def close(self) -> None:
        """Leave it."""
        self._bus.shutdown()


def line_of(message: can.Message) -> str:
    """A frame as a line."""
    width, kind = (8, "T") if message.is_extended_id else (3, "t")
    return f"{kind}{message.arbitration_id:0{width}X}{len(message.data)}{bytes(message.data).hex().upper()}\r"


def message_of(line: str) -> can.Message | None:
    """The frame in a line, None where there is none."""
    width = 8 if line[0] == "T" else 3
    try:
        length = int(line[1 + width])
        data = bytes.fromhex(line[2 + width : 2 + width + 2 * length])
        identifier = int(line[1 : 1 + width], 16)
    except (ValueError, IndexError):
        return None
    if len(data) != length:
        return None
    return can.Message(arbitration_id=identifier, is_extended_id=width == 8, data=data)
