"""Read a dataset with numpy: pick shots with SQL, look at their passes, at their labels, at light.

python examples/read_numpy.py out/demo
"""

from __future__ import annotations

import sys

import numpy as np

from synthgen import open_dataset


def main(folder: str) -> None:
    # Every column of the manifest can be asked for; `synthgen query DIR "DESCRIBE manifest"` lists.
    dataset = open_dataset(folder, split="train", where="person_age_years >= 18")
    print(f"{len(dataset)} shots of adults to train on")
    for shot in dataset:
        inside = shot.alpha > 127  # (H, W), 8 bits
        face = shot.rgb[0][inside]  # rgb: (lights, H, W, 3), 8 bits, sRGB
        nearest = shot.depth[inside].min()  # (H, W), metres along the optical axis
        towards = np.linalg.norm(shot.normal[inside].astype(np.float32), axis=-1)  # camera axes
        print(
            f"{shot.key}: {len(shot.rgb)} lights, mean colour {face.mean(0).round()}, "
            f"nearest point {nearest:.2f} m, normals of length {towards.mean():.2f}, "
            f"{shot.meta['landmarks']['visible'].count(True)} landmarks seen"
        )
    use = dataset[0].meta["environments"][0]
    panorama = dataset.environment(use["id"])  # (H, 2H, 3), linear radiance
    print(f"the first is lit by {use['id']}, {panorama.shape[1]} x {panorama.shape[0]} texels")


if __name__ == "__main__":
    main(*sys.argv[1:])
