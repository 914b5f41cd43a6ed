"""A server that speaks the real-time protocol of Qualisys Track Manager, written from its description alone.

Little-endian packets of an 8-byte header and what the type says; commands are answered, and data are sent when a test
asks for it. Nothing of it comes from the package that reads them.
"""

import socket
import struct
import threading
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

ERROR, COMMAND, XML, DATA, NO_DATA, EVENT = 0, 1, 2, 3, 4, 6
CAPTURE_STARTED, SETTINGS_CHANGED = 3, 11
CORNERS = np.array([[600.0, -400.0, 2.0], [0.0, -400.0, 2.0], [0.0, 0.0, 0.0], [600.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Laboratory:
    """What a server states of itself."""

    labels: tuple[str, ...] = ("A", "B", "C")
    rate: float = 100.0
    force_rate: float = 1000.0
    plates: dict[str, np.ndarray] = field(default_factory=lambda: {"left": CORNERS, "right": CORNERS + [700.0, 0, 0]})
    up: str = "+Z"
    first_id: int = 1

    def xml(self) -> str:
        """The answer to ``GetParameters General 3D Force``."""
        labels = "".join(f"<Label><Name>{name}</Name><RGBColor>255</RGBColor></Label>" for name in self.labels)
        return (
            f"<QTM_Parameters_Ver_1.20><General><Frequency>{self.rate:g}</Frequency></General>"
            f"<The_3D><AxisUpwards>{self.up}</AxisUpwards><Labels>{len(self.labels)}</Labels>{labels}</The_3D>"
            f"<Force><Unit_Length>mm</Unit_Length><Unit_Force>N</Unit_Force>{self._plates()}</Force>"
            "</QTM_Parameters_Ver_1.20>"
        )

    def _plates(self) -> str:
        plates = ""
        for k, (name, corners) in enumerate(self.plates.items()):
            places = "".join(
                f"<Corner{n + 1}><X>{x!r}</X><Y>{y!r}</Y><Z>{z!r}</Z></Corner{n + 1}>"
                for n, (x, y, z) in enumerate(corners.tolist())
            )
            plates += (
                f"<Plate><Plate_ID>{self.first_id + k}</Plate_ID><Frequency>{self.force_rate:g}</Frequency>"
                f"<Type>AMTI</Type><Name>{name}</Name><Location>{places}</Location></Plate>"
            )
        return plates


def packet(kind: int, content: bytes) -> bytes:
    """A whole packet."""
    return struct.pack("<II", 8 + len(content), kind) + content


def markers_part(markers: np.ndarray) -> bytes:
    """The component of markers (markers, 3) [mm]."""
    return packet(1, struct.pack("<Ihh", len(markers), 0, 0) + np.asarray(markers, "<f4").tobytes())


def forces_part(plates: list[tuple[int, int, np.ndarray]]) -> bytes:
    """The component of plates, each its id, the number of its first sample, and samples (samples, 9) [N, N m, mm]."""
    out = struct.pack("<i", len(plates))
    for identity, number, samples in plates:
        out += struct.pack("<iii", identity, len(samples), number) + np.asarray(samples, "<f4").tobytes()
    return packet(4, out)


def data(frame: int, stamp_us: int, *parts: bytes) -> bytes:
    """A packet with components."""
    return packet(DATA, struct.pack("<qII", stamp_us, frame, len(parts)) + b"".join(parts))


def in_plate(wrench: np.ndarray, corners: np.ndarray, about: np.ndarray | None = None) -> np.ndarray:
    """What QTM sends (samples, 9) for wrenches (samples, 6) on the subject about the origin of the world [N, N m].

    Corner 1 is at +X +Y of the plate's axes, 2 at -X +Y, 3 at -X -Y and 4 at +X -Y; Z is down, the load is that on the
    plate, and its application point lies in the surface. ``about`` is the point of moments in these axes [m].
    """
    one, two, three, four = corners / 1e3
    x = (one + four) - (two + three)
    z = np.cross(x, (one + two) - (three + four))
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    axes = np.stack([x, np.cross(z, x), z])
    force = -wrench[:, :3] @ axes.T
    moment = -(wrench[:, 3:] - np.cross(corners.mean(axis=0) / 1e3, wrench[:, :3])) @ axes.T
    point = np.stack([-moment[:, 1] / force[:, 2], moment[:, 0] / force[:, 2], 0.0 * force[:, 2]], axis=1)
    if about is not None:
        moment = moment - np.cross(about, force)
    return np.concatenate([force, moment, 1e3 * point], axis=1)


class Server:
    """Listens until closed; a port of zero takes a free one."""

    def __init__(self, laboratory: Laboratory | str, port: int = 0, greeting: bytes | None = None) -> None:
        self.laboratory, self.commands, self.deaf = laboratory, [], False
        self._greeting = packet(COMMAND, b"QTM RT Interface connected\0") if greeting is None else greeting
        self._socket = socket.create_server(("127.0.0.1", port))
        self.port = self._socket.getsockname()[1]
        self._clients, self.streams, self._threads = [], [], []
        self._start(self._accept)

    def _start(self, work, *words) -> None:
        thread = threading.Thread(target=work, args=words, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._socket.accept()
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients.append(client)
                client.sendall(self._greeting)
                self._start(self._serve, client)

    def _serve(self, client: socket.socket) -> None:
        with suppress(OSError), client.makefile("rb") as file:
            while header := file.read(8):
                size, kind = struct.unpack("<II", header)
                command = file.read(size - 8).rstrip(b"\0").decode()
                assert kind == COMMAND
                self.commands.append(command)
                if not self.deaf:
                    client.sendall(self._answer(command.lower(), client))
        with suppress(ValueError):
            self.streams.remove(client)

    def _answer(self, command: str, client: socket.socket) -> bytes:
        if command.startswith("version "):
            return packet(COMMAND, f"Version set to {command.split()[1]}\0".encode())
        if command == "qtmversion":
            return packet(COMMAND, b"QTM Version is 2024.3 (build 1)\0")
        if command.startswith("getparameters"):
            if self.laboratory == "":
                return packet(ERROR, b"Parameters not available\0")
            xml = self.laboratory if isinstance(self.laboratory, str) else self.laboratory.xml()
            return packet(XML, xml.encode() + b"\0")
        if command == "streamframes allframes 3d force":
            self.streams.append(client)
            return packet(NO_DATA, b"")
        return packet(ERROR, b"Parse error\0")

    def send(self, content: bytes) -> None:
        """To all who asked for a stream."""
        for client in list(self.streams):
            with suppress(OSError):
                client.sendall(content)

    def close(self) -> None:
        """As one that is killed."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        for client in self._clients:
            with suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        for client in self._clients:
            client.close()

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
