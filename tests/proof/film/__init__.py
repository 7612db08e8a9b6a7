"""Pictures of pages: a browser without a window, and its clips.

- `chromium`: Chromium driven over its debugging pipe, for tests too
- `clip`: a clip of `softdyn play`
"""
