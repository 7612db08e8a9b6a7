"""Pages as pictures: a browser without a window, and what it films.

- `chromium`: Chromium driven over its debugging pipe, for tests too
- `clip`: `softdyn play` in motion
"""
