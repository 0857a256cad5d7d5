"""The stage: floor, contact shadow, boundaries and backdrop, drawn around the object.

`frame` holds it as plain data, `build` makes it once per clip from the scene's boundaries
(`solids`), the Gaussians' shadow (`shadow`) and the view's background; `draw` uploads it.
"""
