"""Interactive page of a running simulation: a 3-D scene, and controls that become interventions.

- `session`: the running loop and the operator's requests; the only owner of the state.
- `changes`: interventions as tables: merged, dated and undone; `saved`: a session as a scenario file.
- `scene`: a step of the loop as objects of the 3-D scene.
- `panel`: controls beside the scene; each change becomes a request to the session.
- `access`, `messages`: who may connect, and which messages are acted on; `server`: viser behind these checks.
- `page`: all of these together, and the thread that draws.

The page reads steps and asks for interventions. It never reads or writes the world itself.
"""
