"""The robot in the browser.

Which file holds what
---------------------
scene
    A robot as plain data: links, shapes, cables; the colour of a cable by its tension (`TENSION`).
tendon_paths
    Where to draw a fixed tendon, which has a length but no path.
rest_sweep
    The motion that ``scripts/view.py`` shows: at rest, then what each input does.
show
    `softdyn.show`: one pose at a time, in a notebook, a file or the browser.
page
    One HTML page of robots in motion, replayed or live.
loopback
    A socket on this machine, and which requests are its own.
server
    The page on this machine's loopback; the one file that imports Meshcat.
web
    The browser's part: page, style, player.
live
    The page and the server of a robot that runs elsewhere; rests by slider.
"""
