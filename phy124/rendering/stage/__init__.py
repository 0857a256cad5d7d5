"""The stage: floor, contact shadow, boundaries and backdrop, drawn around the object.

What is drawn is plain data (`frame`), made once per clip (`build`) from the scene's boundaries
(`solids`), its floor (`ground`), the Gaussians (`shadow`) and the view's background (`backdrop`).
"""
