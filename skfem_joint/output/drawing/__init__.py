"""Pictures of bodies, drawn by VTK and put together by matplotlib.

`pictures` shows stick and slip on the moving structure, `preview` and `preview_picture` a structure
before it is run, `shapes` its modes; `offscreen` lets VTK draw where there is no display.
"""
