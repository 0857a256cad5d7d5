"""The stage: floor, contact shadow, boundaries and backdrop, drawn around the object.

`frame` describes the stage of a frame as plain data. `build` creates the stage of a clip from the
scene's boundaries (`solids`), the shadow of the Gaussians (`shadow`) and the view's background.
`draw` uploads the stage to the device and renders it.
"""
