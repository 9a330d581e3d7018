"""`aminn play`: one HTML file in which a trained model runs, compiled to WebAssembly, on recorded grasps.

`page.py` chooses grasps and writes the file from `page.html`, `style.css` and the scripts beside it. `main.mjs` is the
page, `panel.mjs` its numbers, `scene.mjs` what the picture shows, `view.mjs` WebGL; `shapes.mjs`, `hand.mjs` and
`vector.mjs` are geometry. The model itself is `runtime/wasm/aminn.mjs`.
"""

from .page import GRASPS, play

__all__ = ["GRASPS", "play"]
