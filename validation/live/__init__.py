"""A plant and a controller that run in front of live pages (`softdyn.view.live`).

- `session`: a plant and a controller that change while they run, without a clock
- `menu`: the controllers that a page offers
- `dragged_targets`: the target of the tip, or those of tasks, that a page drags
- `push`, `ghost`: a pull by the mouse on a link; the analytic model beside the plant
- `playing`: a session on a clock: `softdyn play`, `softdyn.validation.play`
- `watching`: a closed loop in front of pages that only watch
"""
