"""The robot in the browser.

Files
-----
scene
    A robot as plain data: links, shapes, cables; the colour of a cable by its tension (`TENSION`).
skin
    The smooth skin of a soft arm: rings that the page draws a surface through.
tendon_paths
    The drawn path of a fixed tendon, which has a length but no path of its own.
rest_sweep
    The motion that ``scripts/view.py`` shows: rest, then the response to each input.
show
    `softdyn.show`: one pose at a time, in a notebook, a file or the browser.
page
    One HTML page of robots in motion, replayed or live.
loopback
    A socket on this machine, and the test that a request comes from this machine.
web
    The browser's part: page, style, player.
live
    The server of every page; the page of a robot that runs elsewhere; equilibria by slider.
"""
