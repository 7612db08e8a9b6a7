"""The page of a live robot and its server; a control loop or an explorer moves the robot.

- `messages`: the messages of a page as frozen data, read and checked
- `frames`: a frame, the row of numbers that a page draws
- `pacing`: the clock of a loop
- `channel`: the loop's end: sends frames and states, receives checked messages
- `server`, `boxes`, `recording`: the server, a separate process; its queues and its recordings
- `page`: the page, with its assets in ``web``
- `explorer`: sliders for joints or inputs, and the equilibrium under those inputs

A loop opens a `channel.Channel` by `page.open_live_page`, sends rows of `frames.Columns` and reads
messages.
"""
