"""Pictures of pages: a browser without a window, and its clips.

- `clip`: a clip of `softdyn play`
"""
