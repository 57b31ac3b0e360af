"""Public names of `irisjax.infer`; each loads from its module when it is first used."""

from .analysis import PredictiveCheck as PredictiveCheck
from .analysis import Row as Row
from .analysis import predictive as predictive
from .analysis import predictive_check as predictive_check
from .fit import Fit as Fit
from .fit import FitStatus as FitStatus
from .identifiability import Direction as Direction
from .identifiability import Information as Information
from .importance import Start as Start
from .model_comparison import Assessment as Assessment
from .model_comparison import candidates_of as candidates_of
from .parameters import DEFAULT_FREE as DEFAULT_FREE
from .parameters import PARAMETERS as PARAMETERS
from .parameters import Parameter as Parameter
from .parameters import of_iris as of_iris
from .posterior import Chains as Chains
from .posterior import ChainStatus as ChainStatus
from .posterior import Density as Density
from .priors import AbstractPrior as AbstractPrior
from .priors import LogitNormal as LogitNormal
from .priors import LogNormal as LogNormal
from .priors import LogUniform as LogUniform
from .priors import Normal as Normal
from .priors import Uniform as Uniform
