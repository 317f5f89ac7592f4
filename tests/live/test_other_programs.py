"""Real connections with other programs: pyigtl, and the C++ reference library's own examples."""

import shutil
import socket
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from waiting import WITHIN_S, until

from dvf_ig.live.igtl import Image, Message, Text, Transform
from dvf_ig.live.link import Arrival, Inbox, connect, listen

pyigtl = pytest.importorskip("pyigtl")

EXAMPLES = Path("/usr/share/doc/openigtlink-examples/examples")
INCLUDE = Path("/usr/include/openigtlink")
POSE = np.array([[0.0, -1.0, 0.0, 12.5], [1.0, 0.0, 0.0, -7.0], [0.0, 0.0, 1.0, 99.0], [0.0, 0.0, 0.0, 1.0]])
OURS = Message("MrFromTracker", 12.25, Transform(POSE))


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def taken_from(inbox: Inbox, count: int = 1) -> list[Message]:
    found: list[Arrival] = []

    def enough() -> bool:
        found.extend(inbox.take(0.1))
        return len(found) >= count

    until(enough)
    messages = [arrival.taken for arrival in found]
    assert all(isinstance(message, Message) for message in messages), messages
    return [message for message in messages if isinstance(message, Message)]


# ------------------------------------------------------------------ pyigtl


def test_pyigtl_client_sends_and_receives():
    inbox = Inbox()
    with listen("127.0.0.1", 0, inbox) as server:
        client = pyigtl.OpenIGTLinkClient(host="127.0.0.1", port=server.port)
        try:
            until(lambda: client.is_connected() and len(server.peers) == 1)
            pixels = np.arange(24, dtype=np.uint8).reshape(1, 4, 6)
            client.send_message(pyigtl.TransformMessage(POSE, device_name="ProbeToTracker", timestamp=3.5))
            client.send_message(pyigtl.ImageMessage(pixels, device_name="Image_Tracker"))
            client.send_message(pyigtl.StringMessage("0.1 0.2", device_name="EcgData"))
            pose, image, text = taken_from(inbox, 3)
            assert (pose.device, pose.stamp_s) == ("ProbeToTracker", 3.5)
            assert isinstance(pose.content, Transform)
            np.testing.assert_array_equal(pose.content.matrix, POSE)
            assert isinstance(image.content, Image)
            np.testing.assert_array_equal(image.content.pixels, pixels)
            assert text.content == Text("0.1 0.2")
            server.send((OURS,))
            back = client.wait_for_message("MrFromTracker", timeout=WITHIN_S)
            assert back is not None
            np.testing.assert_allclose(back.matrix, POSE)
        finally:
            client.stop()


def test_pyigtl_server_sends_and_receives():
    inbox, port = Inbox(), free_port()
    server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
    try:
        with connect("127.0.0.1", port, inbox) as client:
            until(lambda: server.is_connected() and len(client.peers) == 1)
            server.send_message(pyigtl.TransformMessage(POSE, device_name="ToolToTracker", timestamp=3.5))
            (pose,) = taken_from(inbox)
            assert pose.device == "ToolToTracker"
            client.send((OURS,))
            back = server.wait_for_message("MrFromTracker", timeout=WITHIN_S)
            assert back is not None
            np.testing.assert_allclose(back.matrix, POSE)
    finally:
        server.stop()


# ------------------------------------------------------------------ the reference library


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Examples of the C++ library, built."""
    compiler = shutil.which("g++")
    if compiler is None or not INCLUDE.is_dir() or not EXAMPLES.is_dir():
        pytest.skip("needs g++ and the Debian packages libopenigtlink-dev and openigtlink-examples")
    folder = tmp_path_factory.mktemp("reference")
    sources = ("Tracker/TrackerServer", "Tracker/TrackerClient", "Receiver/ReceiveClient")
    built = {Path(name).name: folder / Path(name).name for name in sources}
    libraries = ("-lOpenIGTLink", "-lpthread")
    runs = [
        subprocess.Popen(
            [
                compiler,
                "-w",
                f"-I{INCLUDE}",
                "-o",
                built[Path(name).name],
                f"{EXAMPLES / name}.cxx",
                *libraries,
            ]
        )
        for name in sources
    ]
    assert [run.wait() for run in runs] == [0, 0, 0]
    return built


class Running:
    """A reference program, ended with the context; `said` is what it printed."""

    def __init__(self, *command: object) -> None:
        self.said = ""
        self._process = subprocess.Popen(
            ["stdbuf", "-oL", *map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.said += line

    def __enter__(self) -> "Running":
        self._reader.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        if self._process.stdout is not None:
            self._process.stdout.close()


def test_reference_server_is_read(reference):
    """Its tracker's poses are rigid and carry no stamp; none is refused."""
    inbox, port = Inbox(), free_port()
    with Running(reference["TrackerServer"], port, 100), connect("127.0.0.1", port, inbox) as client:
        messages = taken_from(inbox, 20)
        assert client.peers[0].refused == 0
    assert {type(message.content) for message in messages} == {Transform}
    assert {message.stamp_s for message in messages} == {None}


def test_reference_client_is_read(reference):
    inbox = Inbox()
    with listen("127.0.0.1", 0, inbox) as server:
        with Running(reference["TrackerClient"], "127.0.0.1", server.port, 100):
            messages = taken_from(inbox, 20)
        assert {type(message.content) for message in messages} == {Transform}


def test_reference_client_reads_ours(reference):
    """It prints the matrix row by row, as it understood it, after having checked the checksum."""
    with (
        listen("127.0.0.1", 0, None) as server,
        Running(reference["ReceiveClient"], "127.0.0.1", server.port) as client,
    ):
        until(lambda: len(server.peers) == 1)
        image = Message("Image", 12.25, Image(np.zeros((1, 3, 5), np.uint8), np.eye(4)))
        server.send((OURS, image))
        until(lambda: "Dimensions" in client.said)
        server.send((OURS,))
        until(lambda: client.said.count("=====") >= 2)
    assert "0, -1, 0, 12.5" in client.said
    assert "1, 0, 0, -7" in client.said
    assert "(5, 3, 1)" in client.said
