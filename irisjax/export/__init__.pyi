"""Public names of `irisjax.export`; each loads from its module when it is first used."""

from .coats import painting_files as painting_files
from .coats import write_painting as write_painting
from .handover import Exported as Exported
from .handover import export as export
from .mesh import Mesh as Mesh
from .mesh import eye_meshes as eye_meshes
from .mesh import write_eye as write_eye
