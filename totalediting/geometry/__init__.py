"""Space, volume rendering, deformation, and the bust as control points."""
