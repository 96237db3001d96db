import numpy as np
import pytest
from recorded_motions import write_motion

from assets_procedural.motion import recorded
from assets_procedural.motion.poses import ARKIT_NAMES, PoseSettings
from assets_procedural.motion.recorded import RecordingError

SETTINGS = PoseSettings(frames_per_second=10.0)


def jaws(poses):
    return np.array([pose.expression.get("jawOpen", 0.0) for pose in poses])


def play(folder, frames, seed=0, settings=SETTINGS):
    return recorded.play(np.random.default_rng(seed), recorded.read(folder), frames, settings)


def test_poses_follow_the_track_at_the_rate_that_is_asked_for(tmp_path):
    write_motion(tmp_path / "a.parquet")
    poses, motion = play(tmp_path, 20)
    assert (motion.table, motion.source) == ("a.parquet", "clip.mp4")
    assert np.allclose(np.diff(motion.seconds), 0.1, atol=1e-3)
    # The jaw opens by 1 in 99 / 25 seconds.
    assert np.allclose(jaws(poses), np.array(motion.seconds) * 25 / 99, atol=0.02)
    yaws = np.array([pose.head[2] for pose in poses])
    assert np.allclose(np.diff(yaws), 0.3 * 2.5 / 99, atol=2e-3)
    assert {pose.gaze for pose in poses} == {(0.1, 0.0)}


def test_which_stretch_comes_of_the_seed(tmp_path):
    write_motion(tmp_path / "a.parquet")
    write_motion(tmp_path / "b.parquet", "other.mp4")
    drawn = [play(tmp_path, 8, seed) for seed in range(8)]
    assert drawn == [play(tmp_path, 8, seed) for seed in range(8)]
    assert {motion.table for _, motion in drawn} == {"a.parquet", "b.parquet"}
    assert len({motion.seconds for _, motion in drawn}) == 8


def test_a_short_track_goes_back_and_forth_without_a_jump(tmp_path):
    write_motion(tmp_path / "a.parquet", frames=26)
    poses, motion = play(tmp_path, 60)
    assert min(motion.seconds) >= 0 and max(motion.seconds) <= 1
    assert np.abs(np.diff(jaws(poses))).max() < 0.11


def test_gaze_and_head_stay_in_their_ranges(tmp_path):
    settings = PoseSettings(gaze_yaw=(-2.0, 2.0), head_yaw=(-1.0, 1.0))
    write_motion(tmp_path / "a.parquet")
    poses, _ = play(tmp_path, 30, settings=settings)
    assert max(abs(pose.gaze[0]) for pose in poses) <= np.radians(2) + 1e-4
    assert max(abs(pose.head[2]) for pose in poses) <= np.radians(1) + 1e-4


def test_a_gap_ends_a_recording_and_lids_are_left_to_the_gaze(tmp_path):
    seconds = np.arange(100) / 25
    seconds[50:] += 3
    expression = np.zeros((100, 52))
    expression[:, [name.startswith("eyeLook") for name in ARKIT_NAMES]] = 0.5
    write_motion(tmp_path / "a.parquet", seconds=seconds, expression=expression)
    found = recorded.read(tmp_path)
    assert [round(one.span, 2) for one in found] == [1.96, 1.96]
    assert not found[0].values[:, :52].any()


def test_what_is_copied_says_nothing_of_who_it_was(tmp_path):
    (tmp_path / "copy").mkdir()
    path = write_motion(tmp_path / "it's [1].parquet")
    recorded.copy(tmp_path / "copy", path)
    assert recorded.same(recorded.read(tmp_path / "copy"), recorded.read(tmp_path))
    assert b"identity" not in (tmp_path / "copy" / path.name).read_bytes()


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        ({"expression": np.full((100, 52), 2.0)}, "expression: values are from 0 to 1"),
        ({"gaze": np.full((100, 2), 30.0)}, "angles are in radians"),
        ({"head": np.full((100, 3), np.nan)}, "head: a value is missing or not finite"),
        ({"seconds": np.zeros(100)}, "no face in it is seen"),
    ],
)
def test_a_bad_table_is_one_line(tmp_path, changed, line):
    write_motion(tmp_path / "a.parquet", **changed)
    with pytest.raises(RecordingError, match=line) as error:
        recorded.read(tmp_path)
    assert "\n" not in str(error.value)


def test_a_folder_without_tables_and_a_file_that_is_none_are_one_line(tmp_path, monkeypatch):
    with pytest.raises(RecordingError, match="give a folder"):
        recorded.read(tmp_path / "no")
    with pytest.raises(RecordingError, match="fill it with `totalediting track`"):
        recorded.read(tmp_path)
    (tmp_path / "a.parquet").write_text("hello")
    with pytest.raises(RecordingError, match=r"a\.parquet: no table of `totalediting track`"):
        recorded.read(tmp_path)
    write_motion(tmp_path / "a.parquet")
    monkeypatch.setattr(recorded, "MOST_FRAMES", 99)
    with pytest.raises(RecordingError, match="more than 99 frames"):
        recorded.read(tmp_path)
