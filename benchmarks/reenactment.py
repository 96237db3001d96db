"""How well a trained model shows held-out people, beside trivial answers and the plain decoder.

    python benchmarks/reenactment.py RUN DATA [--split test] [--plain RUN]

Prints Markdown tables of PSNR (dB, over black by the true matte: of all pixels, and of the matte's
alone) and LPIPS (AlexNet, where its weights are at hand). Self-reenactment: another shot of the
person is the source, the driver's own motion, camera and light are given; beside it the source
itself, the mean training picture, and with `--plain` another run, trained on the same data for as
many steps with `--set decoder=plain`. Reproduction: source and target are one picture. Relighting:
they are one shot under two of its environments; beside it the source, and the model's own picture
in the source's light. A last line says how much of the difference between a shot's two lights is
left in the albedos found from either (mean absolute, display-referred, matte).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import report
import torch
from torch import Tensor
from torch.nn import functional

from totalediting import metrics
from totalediting.data.endless import loader
from totalediting.data.pairs import PortraitPair, PortraitPairs
from totalediting.light.phong import display
from totalediting.model import TotalEditing
from totalediting.pretrained.fetch import NetworkError
from totalediting.pretrained.lpips import Lpips
from totalediting.training import checkpoints
from totalediting.training.reconstruction import edit_of
from totalediting.training.showcase import load_model

AT_ONCE = 8  # pairs


class Scores:
    """Means of PSNR and LPIPS by name."""

    def __init__(self) -> None:
        self.found: dict[str, list[Tensor]] = {}
        try:
            self.lpips = Lpips("alex").eval()
        except NetworkError as error:
            print(f"without LPIPS: {error}")
            self.lpips = None

    def add(self, name: str, picture: Tensor, truth: Tensor, matte: Tensor) -> None:
        found = [
            metrics.psnr(picture, truth, matte),
            metrics.psnr_within(picture, truth, matte),
        ]
        if self.lpips is not None:
            found.append(self.lpips(matte * picture, matte * truth).flatten())
        self.found.setdefault(name, []).append(torch.stack(found))

    def show(self, title: str) -> None:
        heads = ["PSNR, dB", "of the matte"] + ["LPIPS"] * (self.lpips is not None)
        means = {name: torch.cat(parts, 1).mean(1) for name, parts in self.found.items()}
        report.table(
            [title, *heads],
            [[name, *(f"{value:.3g}" for value in mean.tolist())] for name, mean in means.items()],
        )
        self.found = {}


def mean_picture(data: Path, model: TotalEditing) -> Tensor:
    """(3, S, S) the mean of the training pictures, over black."""
    pairs = PortraitPairs(data, model.preset, "train")
    count = min(256, len(pairs))
    batches = loader(pairs, AT_ONCE, stop=count)
    return torch.stack([(b.alpha * b.mot_image).sum(0) / count for b in batches]).sum(0)


def relit(batch: PortraitPair) -> PortraitPair:
    """The motion shot as its own source, to be shown in its other light."""
    assert batch.relit is not None
    source = batch.app._replace(
        image=batch.mot_image,
        alpha=batch.alpha,
        code=batch.mot_code,
        control=batch.control,
        camera_to_world=batch.camera_to_world,
        intrinsics=batch.intrinsics,
        lightmaps=batch.lightmaps,
    )
    return batch._replace(
        app=source,
        mot_image=batch.relit.image,
        lightmaps=batch.relit.lightmaps,
    )


def from_other_light(lit: PortraitPair, batch: PortraitPair) -> PortraitPair:
    """What `relit` gives, with the source in the other light as well."""
    source = lit.app._replace(image=lit.mot_image, lightmaps=lit.lightmaps)
    return lit._replace(app=source, lightmaps=batch.lightmaps)


def difference(a: Tensor, b: Tensor, matte: Tensor) -> Tensor:
    """(B,) mean absolute difference of pictures by a matte."""
    small = functional.interpolate(matte, a.shape[-2:], mode="area")
    apart = (a - b).abs().mean(1, keepdim=True)
    return (small * apart).sum((1, 2, 3)) / small.sum((1, 2, 3))


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--plain", type=Path)
    arguments = parser.parse_args()
    model = load_model(arguments.run)
    plain = load_model(arguments.plain) if arguments.plain else None
    trained_on = Path(checkpoints.read_config(arguments.run / "reconstruct")["data"])
    mean = mean_picture(trained_on, model)
    pairs = PortraitPairs(arguments.data, model.preset, arguments.split, relit=True)
    reenacted, reproduced, relighting, left_in_albedo = Scores(), Scores(), Scores(), []
    for batch in loader(pairs, AT_ONCE, stop=len(pairs)):
        truth, matte = batch.mot_image, batch.alpha
        reenacted.add("model", edit_of(model, batch, None).image, truth, matte)
        if plain is not None:
            reenacted.add("plain decoder", edit_of(plain, batch, None).image, truth, matte)
        reenacted.add("the source itself", batch.app.image, truth, matte)
        reenacted.add("the mean training picture", mean.expand_as(truth), truth, matte)

        lit = relit(batch)
        truth = lit.mot_image
        relighting.add("model, relit", edit_of(model, lit, None).image, truth, matte)
        still = edit_of(model, lit, None, batch.lightmaps)
        other = edit_of(model, from_other_light(lit, batch), None)
        first, second = (display(edit.rendering.albedo, 1) for edit in (still, other))
        apart = difference(batch.mot_image, truth, matte)
        left_in_albedo.append(difference(first, second, matte) / apart)
        reproduced.add("model", still.image, batch.mot_image, matte)
        relighting.add("model, in the source's light", still.image, truth, matte)
        if plain is not None:
            relighting.add("plain decoder", edit_of(plain, lit, None).image, truth, matte)
        relighting.add("the source itself", batch.mot_image, truth, matte)
    reenacted.show("self-reenactment")
    reproduced.show("reproduction")
    relighting.show("relighting")
    share = torch.cat(left_in_albedo)
    share = share[share.isfinite()].median().item()
    print(f"\nof the difference between two lights, left in the albedo: {share:.2f} (median)")


if __name__ == "__main__":
    main()
