"""Handing out subjects to workers. Variants differ only in how the work is handed out."""

DEFAULT_RENDERER = "synthgen.stage.render:render_subject"
"""What renders a subject unless a test says otherwise: "package.module:function"."""
