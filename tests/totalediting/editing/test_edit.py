import struct
from dataclasses import replace

import av
import numpy as np
import pytest
from known_faces import NOBODY, a_portrait, save
from PIL import Image
from videos import write_video

from assets_procedural.conventions import panorama_files
from totalediting.editing import edit as module
from totalediting.editing import output, sources
from totalediting.editing.edit import Job, edit
from totalediting.errors import InputError
from totalediting.light.files import read_lightmaps


@pytest.fixture
def job(tmp_path):
    panorama_files.write(tmp_path / "l.exr", np.full((8, 16, 3), 0.5, np.float32), {})
    appearance = save(tmp_path / "a.png", a_portrait())
    return Job(appearance, tmp_path / "o.png", lighting=tmp_path / "l.exr")


def left_in(folder):
    """Names of what is there beside the inputs."""
    return sorted(p.name for p in folder.iterdir() if p.name not in ("a.png", "l.exr", "m.mp4"))


def test_a_picture_says_what_it_is(editor, job):
    edit(job, editor)
    with Image.open(job.out) as image:
        assert output.SOURCE_TYPE in image.info["XML:com.adobe.xmp"]
        assert image.size == (160, 120)


def with_sound(path, levels, rate=10):
    """A video of grey levels, with a tone over all of it."""
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", rate=rate)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        audio = container.add_stream("aac", rate=44_100, layout="mono")
        for level in levels:
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), level, np.uint8), "rgb24")
            container.mux(video.encode(frame))
        container.mux(video.encode())
        wave = 9000 * np.sin(0.06 * np.arange(44_100 * len(levels) // rate))
        heard = av.AudioFrame.from_ndarray(wave.astype(np.int16)[None], "s16", "mono")
        heard.rate, heard.pts = 44_100, 0
        container.mux(audio.encode(heard))
        container.mux(audio.encode())


def boxes(content):
    """Types of the boxes of an MP4 file, and what is in the last."""
    at, found = 0, []
    while at < len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        found.append(kind)
        last, at = content[at + 8 : at + size], at + size
    assert at == len(content)
    return found, last


def test_a_video_keeps_sound_and_times_and_says_what_it_is(editor, job, tmp_path):
    with_sound(tmp_path / "m.mp4", [60, 61, 62, 63])
    job = replace(job, motion=tmp_path / "m.mp4", lighting=None, out=tmp_path / "o.mp4")
    edit(job, editor)
    with av.open(str(job.out)) as container:
        video, audio = container.streams.video[0], container.streams.audio[0]
        assert (video.width, video.height) == (160, 120)
        heard = sum(frame.samples for frame in container.decode(audio)) / 44_100
    with av.open(str(job.out)) as container:
        times = [frame.time for frame in container.decode(video=0)]
    assert np.allclose(times, [0, 0.1, 0.2, 0.3], atol=1e-3) and 0.3 < heard < 0.5
    kinds, last = boxes(job.out.read_bytes())
    assert kinds[-1] == b"uuid" and last.startswith(output.XMP_BOX.bytes)
    assert output.SOURCE_TYPE.encode() in last


def test_frames_without_a_face_are_held_and_said(editor, job, tmp_path):
    write_video(tmp_path / "m.mp4", [0, 100, 0, 102])
    job = replace(job, motion=tmp_path / "m.mp4", lighting=None, out=tmp_path / "frames")
    notes = edit(job, editor)
    assert any("no face in 2 frames" in note for note in notes)
    found = [np.asarray(Image.open(path)) for path in sorted((tmp_path / "frames").iterdir())]
    assert len(found) == 4 and (found[0] == found[1]).all() and (found[1] == found[2]).all()


def test_a_folder_of_pictures_is_a_motion(editor, job, tmp_path):
    (tmp_path / "m").mkdir()
    for number in (9, 10):
        save(tmp_path / "m" / f"{number:02d}.png", a_portrait(number))
    job = replace(job, motion=tmp_path / "m", out=tmp_path / "o")
    edit(job, editor)
    assert left_in(tmp_path / "o") == ["000000.png", "000001.png"]


def test_a_shot_of_a_dataset_brings_its_matte(editor, small_dataset, tmp_path):
    from synthgen.dataset import open_dataset

    dataset = open_dataset(small_dataset)
    key = dataset.keys()[0]
    shot = sources.read_photograph(type(small_dataset)(f"{small_dataset}:{key}"))
    read = dataset.read(0, ("alpha",))["alpha"]
    assert shot.matte is not None and np.allclose(shot.matte, read / 255)
    with pytest.raises(InputError, match=r"nothing: .*its first shot is"):
        sources.read_photograph(type(small_dataset)(f"{small_dataset}:nothing"))


@pytest.mark.parametrize("what", ["orbit", "spin"])
def test_camera_and_light_go_around(editor, job, monkeypatch, what):
    monkeypatch.setattr(module, "_ROUND", 4)
    job = replace(job, out=job.out.with_suffix(""), **{what: True})
    frames = list(module._plan(job, [None], [0, 0.04, 0.08, 0.12]))
    if what == "spin":
        assert [frame.rotate_light for frame in frames] == [0, 90, 180, 270]
    else:
        assert np.allclose([frame.view[0] for frame in frames], [0, 25, 0, -25])
    edit(job, editor)
    assert len(list(job.out.iterdir())) == 4


def test_an_edit_is_taken_apart(editor, job, tmp_path):
    edit(replace(job, decompose=tmp_path / "layers"), editor)
    names = left_in(tmp_path / "layers")
    assert names == sorted([*module.decompose.FILES, "lightmaps.exr"])
    normal = np.asarray(Image.open(tmp_path / "layers" / "normal.png")) / 127.5 - 1
    assert normal[48, 48, 2] > 0.7  # towards the camera
    assert np.allclose(read_lightmaps(tmp_path / "layers" / "lightmaps.exr"), 0.5, atol=1e-2)


def bad_jobs(job, folder):
    """What is asked, and what is said."""
    (folder / "text.mp4").write_text("hello")
    (folder / "there").mkdir()
    write_video(folder / "m.mp4", [0, 0])
    nobody = save(folder / "nobody.png", a_portrait(NOBODY))
    return [
        (replace(job, lighting=None), "nothing to edit"),
        (replace(job, out=folder / "o.mp4"), "is one picture"),
        (replace(job, out=folder / "o.png", spin=True), "is a sequence"),
        (replace(job, out=folder / "no" / "o.png"), "there is no folder"),
        (replace(job, out=folder / "there", orbit=True), "there already"),
        (replace(job, out=job.appearance), "also an input"),
        (replace(job, motion=folder / "no.png"), "no such file"),
        (replace(job, motion=nobody), "no face found"),
        (replace(job, appearance=nobody), "no face found"),
        (replace(job, appearance=folder / "m.mp4"), "is a video"),
        (replace(job, motion=folder / "m.mp4", out=folder / "o.mp4"), "no face found"),
        (replace(job, motion=folder / "text.mp4", out=folder / "o.mp4"), "text.mp4: .*mend it"),
        (replace(job, lighting=folder / "text.mp4"), "is a video"),
        (replace(job, lighting=None, spin=True, orbit=True), "no light to turn"),
        (replace(job, view=(60, 0)), "--view: 60,0"),
        (replace(job, exposure=5.0), "--exposure: 5: give stops from -4 to 4"),
        (replace(job, expression={"grin": 0.5}), "--expression: grin: no such coefficient"),
        (replace(job, expression={"jawOpen": 2.0}), "--expression: jawOpen: 2: give a number"),
        (replace(job, decompose=folder / "d", spin=True, out=folder / "o"), "one picture apart"),
    ]


def test_bad_input_is_one_line_and_nothing_half_written(editor, job, tmp_path):
    cases = bad_jobs(job, tmp_path)
    before = left_in(tmp_path)
    for bad, said in cases:
        with pytest.raises(InputError, match=said) as caught:
            edit(bad, editor)
        assert "\n" not in str(caught.value)
    assert left_in(tmp_path) == before


def test_a_folder_that_cannot_be_written_to_is_said_first(editor, job, monkeypatch):
    monkeypatch.setattr(module.os, "access", lambda *_: False)
    with pytest.raises(InputError, match="not writable"):
        edit(job, editor)
    assert not editor.tracker.looked


def test_endless_and_broken_videos_are_refused(editor, job, tmp_path, monkeypatch):
    write_video(tmp_path / "m.mp4", list(range(60, 80)))
    job = replace(job, motion=tmp_path / "m.mp4", out=tmp_path / "o.mp4")
    monkeypatch.setattr(sources, "MOST_FRAMES", 19)
    with pytest.raises(InputError, match="20 frames; cut it to at most 19"):
        edit(job, editor)
    content = (tmp_path / "m.mp4").read_bytes()
    (tmp_path / "m.mp4").write_bytes(content[: 3 * len(content) // 4])
    with pytest.raises(InputError, match=r"m\.mp4: .*(early|mend it)"):
        edit(job, editor)
    assert left_in(tmp_path) == []


@pytest.mark.parametrize("name", ["o.mp4", "o"])
def test_an_interruption_leaves_nothing(editor, job, tmp_path, monkeypatch, name):
    made = editor.edit

    def interrupted(*values, view, **others):
        if view[0] < -1:
            raise KeyboardInterrupt
        return made(*values, view=view, **others)

    monkeypatch.setattr(module, "_ROUND", 8)
    monkeypatch.setattr(editor, "edit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        edit(replace(job, orbit=True, out=tmp_path / name), editor)
    assert left_in(tmp_path) == []


def test_turned_videos_are_seen_upright(editor, tmp_path):
    write_video(tmp_path / "plain.mp4", [100, 101])
    turned = tmp_path / "m.mp4"
    with av.open(str(tmp_path / "plain.mp4")) as source, av.open(str(turned), "w") as container:
        stream = source.streams.video[0]
        copy = container.add_stream_from_template(stream)
        for packet in source.demux(stream):
            if packet.dts is not None:
                packet.stream = copy
                container.mux(packet)
    content = turned.read_bytes()
    upright = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 0x40000000)
    quarter = struct.pack(">9i", 0, 65536, 0, -65536, 0, 0, 0, 0, 0x40000000)
    at = content.rindex(upright)  # of the track; the first is the movie's
    turned.write_bytes(content[:at] + quarter + content[at + 36 :])
    seen = []
    find = editor.tracker._row
    editor.tracker._row = lambda *values: (seen.append(values[2].shape), find(*values))[1]
    editor.clip(turned)
    assert seen == [(64, 48, 3)] * 2
