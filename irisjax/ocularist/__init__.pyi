"""Public names of `irisjax.ocularist`; each loads from its module when it is first used."""

from .bridge import maps_of as maps_of
from .coats import Coat as Coat
from .coats import Painting as Painting
from .coats import prosthesis as prosthesis
from .component import AbstractComponent as AbstractComponent
from .easel import painted as painted
from .easel import studio as studio
from .integrator import Painted as Painted
from .kubelka_munk import KubelkaMunkMixer as KubelkaMunkMixer
from .matching import Match as Match
from .matching import match as match
from .mixing import AbstractMixer as AbstractMixer
from .mixing import HslMixer as HslMixer
from .palette import PAINTS as PAINTS
from .palette import Palette as Palette
from .plan import plan_view as plan_view
from .plan import texture_of as texture_of
from .recipes import CoatRecipe as CoatRecipe
from .retouching import Retouch as Retouch
from .retouching import retouched as retouched
