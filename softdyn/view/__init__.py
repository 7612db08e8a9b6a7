"""The robot in the browser: scene, tendon paths, pages, the server on the loopback."""
