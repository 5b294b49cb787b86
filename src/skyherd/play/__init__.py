"""Pages with a 3-D scene: of a running simulation, which its controls change, and of a recorded run.

- `session`: the running loop and the operator's requests; the only owner of the state.
- `changes`: interventions as tables: merged, dated and undone; `saved`: a session as a scenario file.
- `scene`: a step of the loop as objects of the 3-D scene. `bodies`, `lines`, `pictures` and `poses` are its
  parts.
- `panel`: controls beside the scene; each change becomes a request to the session. `controls`, `team_tab` and
  `grab` are its parts.
- `access`, `messages`: who may connect, and which messages are acted on; `server`: viser behind these checks.
- `page`: all of these together, and the thread that draws.
- `replay`, `view_page`: the scene of a recorded run, as one HTML file and on a page with a time bar.

The pages read steps and ask for interventions. They never read or write the world itself.
"""
