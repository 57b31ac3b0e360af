"""Public names of `irisjax.export`; each loads from its module when it is first used."""

from .gltf import gltf_files as gltf_files
from .handover import Exported as Exported
from .handover import export_scene as export_scene
from .mesh import cone_mesh as cone_mesh
from .mesh import eye_meshes as eye_meshes
from .mesh import mesh_files as mesh_files
from .mesh import painting_files as painting_files
from .mesh import right_handed as right_handed
from .mesh import strip_meshes as strip_meshes
