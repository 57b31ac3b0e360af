"""Public names of `irisjax.ocularist`; each loads from its module when it is first used."""

from .coats import Coat as Coat
from .coats import Painting as Painting
from .coats import prosthesis as prosthesis
from .components import COMPONENTS as COMPONENTS
from .components import Component as Component
from .components import component as component
from .components import scan as scan
from .cones import Cones as Cones
from .integrator import Painted as Painted
from .kubelka_munk import KubelkaMunkMixer as KubelkaMunkMixer
from .matching import Match as Match
from .matching import Retouch as Retouch
from .matching import match as match
from .matching import retouch as retouch
from .mixing import PAINTS as PAINTS
from .mixing import AbstractMixer as AbstractMixer
from .mixing import HslMixer as HslMixer
from .painting import painted as painted
from .painting import studio as studio
from .plan import plan_view as plan_view
from .plan import texture_of as texture_of
from .recipes import CoatRecipe as CoatRecipe
from .tissue import Tissue as Tissue
from .tissue import nearest_tissue as nearest_tissue
from .tissue import reflectance_of as reflectance_of
