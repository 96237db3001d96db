"""Handing out subjects to workers. Variants differ only in how the work is handed out."""

from typing import Literal

DEFAULT_RENDERER = "synthgen.stage.render:render_subject"
"""What renders a subject unless a test says otherwise: "package.module:function"."""
Device = Literal["cpu", "cuda", "optix", "hip", "metal"]
"""What Cycles can render on."""
