"""The page of a live robot and its server, for whatever moves the robot.

- `messages`: the messages of a page, frozen data, read and checked in one place
- `frames`: a frame, the row of numbers that a page draws
- `pacing`: the clock of a loop
- `channel`: a loop's side: frames and states out, checked messages in
- `server`, `boxes`, `recording`: the server, a process of its own; its queues and its recordings
- `page`: the page, with its assets in ``web``
- `explorer`: joints or inputs by slider, and the rest that they lead to

A loop opens a `channel.Channel` with a `page.live_page`, sends rows of `frames.Columns` and reads
messages.
"""
