"""The server of every page, and the page of a robot that a control loop or an explorer moves.

- `messages`: the messages of a page as frozen data, read and checked
- `frames`: a frame, the row of numbers that a page draws
- `pacing`: the clock of a loop
- `channel`: serves a page: sends frames and states to it, receives checked messages
- `server`, `boxes`, `recording`: the server, a separate process; its queues and its recordings
- `page`: the page, with its assets in ``web``
- `explorer`: sliders for joints or inputs, and the equilibrium under those inputs

A loop opens a `channel.Channel` by `page.open_live_page`, sends rows of `frames.Columns` and reads
messages.
"""
