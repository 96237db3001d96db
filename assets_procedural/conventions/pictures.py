"""Somebody else's pictures: decoded as the format they must be, and never without end.

Pillow looks at what a file holds, and among the dozens of formats that it knows are some that run
programs: PostScript starts Ghostscript. So all three packages open pictures here.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from PIL import Image

from assets_procedural.conventions.files import open_regular

Format = Literal["PNG", "JPEG", "WEBP", "BMP"]
LARGEST = 8192 * 8192
"""Pixels of a picture that is decoded, unless a reader asks for fewer."""


@contextmanager
def open_picture(
    source: bytes | Path, format_: Format = "PNG", most: int = LARGEST
) -> Iterator[Image.Image]:
    """A picture of one format, from a file or from its bytes; nothing is decoded yet.

    Raises `ValueError` for another format, more than `most` pixels or damaged bytes, also while it
    is used, and `OSError` for what is no file.
    """
    with open_regular(source) if isinstance(source, Path) else io.BytesIO(source) as file:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                image = Image.open(file, formats=[format_])
            with image:
                if image.width * image.height > most:
                    size = f"{image.width} x {image.height}"
                    raise ValueError(f"is {size} pixels; at most {most:,} are decoded")
                yield image
        except Image.DecompressionBombError:
            raise ValueError(f"claims too many pixels; at most {most:,} are decoded") from None
        except Image.UnidentifiedImageError:
            raise ValueError(f"is no {format_}") from None
        except (SyntaxError, EOFError) as error:
            raise ValueError(f"is damaged: {error}") from None
