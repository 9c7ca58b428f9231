"""The scene file: read, checked and written.

scene: `Scene`, with load and save. file: the tables, and one message for all that is wrong. loader: the files that it
names. checks: what must fit together. writer: a scene as text. beside: what lies in memory, written to files. new:
`warpsar new`. city, footprints: buildings of a real place. schema: `warpsar schema`. placing: objects in a scene in
memory. unwrap: `warpsar uv`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
