"""A robot live in the browser: its plant and law run here, pages watch, one of them commands.

- `messages`: what a page may say, as frozen data, read and checked in one place
- `frames`: a frame, the row of numbers that a page draws
- `session`: a plant and a law that change while they run, without a clock
- `push`, `ghost`: a hand on a link; the analytic model beside the plant
- `pacing`: the clock a loop keeps, and how well
- `channel`, `server`, `boxes`, `recording`: datagrams to a server in a process of its own, which
  serves the page, keeps what was not read yet, and recordings
- `page`: the page, with its assets in ``web``
- `explorer`: joints or inputs by slider, and the rest that they lead to
- `watching`: a closed loop in front of pages that only watch
- `playing`: a session on a clock in front of pages: `softdyn play`, `softdyn.validation.play`
"""
