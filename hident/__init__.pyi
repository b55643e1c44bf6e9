# The public names and where they are from; a contract test compares them with the register of components.

from hident.api import compare as compare, examine as examine, fit as fit, list_components as list_components
from hident.api import (
    power as power,
    report as report,
    run as run,
    schema as schema,
    score as score,
    simulate as simulate,
    status as status,
)
from hident.api import validate as validate, verify as verify, write as write
from hident.engine.experiment import Experiment as Experiment
from hident.engine.results import Results as Results
from hident.errors import ConfigError as ConfigError, EstimationError as EstimationError
from hident.errors import HidentError as HidentError, SimulationError as SimulationError
from hident.estimators.bilinear_models.bilinear_least_squares import (
    BilinearLeastSquares as BilinearLeastSquares,
)
from hident.estimators.bilinear_models.bounds import CramerRao as CramerRao
from hident.estimators.bilinear_models.bounds import KnownNonlinearity as KnownNonlinearity
from hident.estimators.bilinear_models.separable import SeparableLeastSquares as SeparableLeastSquares
from hident.estimators.bilinear_models.two_stage import TwoStage as TwoStage
from hident.estimators.frequency.best_linear_approximation import BestLinear as BestLinear
from hident.estimators.frequency.frequency_gain_identification import (
    FrequencyGainIdentification as FrequencyGainIdentification,
)
from hident.estimators.frequency.nonlinearity_identification import (
    NonlinearityIdentification as NonlinearityIdentification,
)
from hident.estimators.moving_horizon.hammerstein.iterative_hammerstein import (
    IterativeHammerstein as IterativeHammerstein,
)
from hident.estimators.moving_horizon.wiener.iterative_wiener import IterativeWiener as IterativeWiener
from hident.estimators.moving_horizon.linear_model import LinearModel as LinearModel
from hident.estimators.moving_horizon.output_error_fit import OutputError as OutputError
from hident.estimators.nonparametric.bases import Hermite as Hermite, Laguerre as Laguerre
from hident.estimators.nonparametric.bases import Legendre as Legendre, Trigonometric as Trigonometric
from hident.estimators.nonparametric.instrumental_variables import (
    InstrumentalVariables as InstrumentalVariables,
)
from hident.estimators.nonparametric.kernel import Kernel as Kernel
from hident.estimators.nonparametric.known_dynamics import KnownDynamics as KnownDynamics
from hident.estimators.nonparametric.least_squares import LeastSquares as LeastSquares
from hident.estimators.nonparametric.orthogonal import Orthogonal as Orthogonal
from hident.estimators.prediction_error.block_specs import ContinuousBlock as ContinuousBlock
from hident.estimators.prediction_error.block_specs import CubicSplineBlock as CubicSplineBlock
from hident.estimators.prediction_error.block_specs import DeadZoneBlock as DeadZoneBlock
from hident.estimators.prediction_error.block_specs import ExpansionBlock as ExpansionBlock
from hident.estimators.prediction_error.block_specs import LinearBlock as LinearBlock
from hident.estimators.prediction_error.block_specs import PiecewiseLinearBlock as PiecewiseLinearBlock
from hident.estimators.prediction_error.block_specs import PolynomialBlock as PolynomialBlock
from hident.estimators.prediction_error.block_specs import SaturationBlock as SaturationBlock
from hident.estimators.prediction_error.block_specs import SeriesBlock as SeriesBlock
from hident.estimators.prediction_error.chain_cramer_rao import ChainCramerRao as ChainCramerRao
from hident.estimators.prediction_error.prediction_error import PredictionError as PredictionError
from hident.estimators.selection.select import Select as Select
from hident.estimators.voros.voros_hammerstein import VorosHammerstein as VorosHammerstein
from hident.estimators.voros.voros_wiener import VorosWiener as VorosWiener
from hident.fitted_model import FittedModel as FittedModel
from hident.identification.identify import Identification as Identification, identify as identify
from hident.linear_blocks import ContinuousTransferFunction as ContinuousTransferFunction
from hident.linear_blocks import TransferFunction as TransferFunction
from hident.measurements.first_look import first_look as first_look
from hident.measurements.measured_record import MeasuredRecord as MeasuredRecord, read as read
from hident.metrics.block_responses import FrequencyResponseError as FrequencyResponseError
from hident.metrics.block_responses import ImpulseResponseError as ImpulseResponseError
from hident.metrics.curves import FrequencyResponse as FrequencyResponse
from hident.metrics.curves import ModelOutput as ModelOutput
from hident.metrics.curves import StaticFunctionValues as StaticFunctionValues
from hident.metrics.disturbance import DisturbanceVariance as DisturbanceVariance
from hident.metrics.disturbance import DisturbanceVarianceFormula as DisturbanceVarianceFormula
from hident.metrics.fit import FitIndex as FitIndex, Mae as Mae, Nrmse as Nrmse, Rmse as Rmse
from hident.metrics.fit import RSquared as RSquared
from hident.metrics.frequency import GainShapeError as GainShapeError, MovedDelay as MovedDelay
from hident.metrics.frequency import Response as Response, ResponseError as ResponseError
from hident.metrics.frequency import TrueResponse as TrueResponse
from hident.metrics.models import LinearPercentError as LinearPercentError, OutputMse as OutputMse
from hident.metrics.models import SettlingTime as SettlingTime
from hident.metrics.models import ValidationPercentError as ValidationPercentError
from hident.metrics.nonlinearity import ErrorReduction as ErrorReduction
from hident.metrics.nonlinearity import IntegratedSquaredError as IntegratedSquaredError
from hident.metrics.nonlinearity import NonlinearityPercentError as NonlinearityPercentError
from hident.metrics.nonlinearity import NonlinearityValue as NonlinearityValue
from hident.metrics.residuals import ResidualTest as ResidualTest
from hident.metrics.values import Coverage as Coverage, Error as Error, PercentError as PercentError
from hident.metrics.values import Share as Share, TrueValue as TrueValue, Value as Value
from hident.models.control_export import initial_state as initial_state, to_control as to_control
from hident.models.convert import convert as convert
from hident.models.formulas import formulas as formulas
from hident.models.model_file import load_model as load_model, write_model as write_model
from hident.records import Estimate as Estimate, Record as Record
from hident.reports.figures.bands import Bands as Bands
from hident.reports.figures.bode import Bode as Bode
from hident.reports.figures.comparisons import CriticalDifferences as CriticalDifferences
from hident.reports.figures.comparisons import PairedDifferences as PairedDifferences
from hident.reports.figures.curve import Curve as Curve
from hident.reports.figures.limits import LimitFigure as LimitFigure
from hident.reports.figures.parameters import EfficiencyFigure as EfficiencyFigure, Gain as Gain
from hident.reports.figures.parameters import ParameterFigure as ParameterFigure
from hident.reports.figures.scatter import Scatter as Scatter
from hident.reports.one_trial.convergence import Convergence as Convergence
from hident.reports.one_trial.experiments import LevelMeans as LevelMeans, Signals as Signals
from hident.reports.one_trial.realisation import Realisation as Realisation
from hident.reports.one_trial.responses import SettlingMap as SettlingMap, Validation as Validation
from hident.reports.one_trial.residuals import ResidualFigure as ResidualFigure
from hident.reports.one_trial.searches import Search as Search
from hident.reports.one_trial.static_fits import StaticFit as StaticFit
from hident.reports.tables.agreement import Agreement as Agreement
from hident.reports.tables.against_truth import AgainstTruth as AgainstTruth
from hident.reports.tables.candidates import Candidates as Candidates
from hident.reports.tables.attained import Attained as Attained
from hident.reports.tables.choices import Choices as Choices
from hident.reports.tables.comparison import Comparison as Comparison
from hident.reports.tables.distances import Distance as Distance, JointDistance as JointDistance
from hident.reports.tables.distributions import Distribution as Distribution
from hident.reports.tables.grid import Grid as Grid
from hident.reports.tables.limits import Limit as Limit
from hident.reports.tables.parameters import Efficiency as Efficiency, Parameters as Parameters
from hident.reports.tables.rate import Rate as Rate
from hident.signals.excitation import Filtered as Filtered, Iid as Iid, Multisine as Multisine
from hident.signals.excitation import Multistep as Multistep, Prbs as Prbs, Sine as Sine
from hident.signals.excitation import Staircase as Staircase
from hident.signals.experiments import Experiments as Experiments, SteppedSine as SteppedSine
from hident.signals.matlab5_streams import Matlab5Streams as Matlab5Streams
from hident.signals.noise import Autoregressive as Autoregressive, Rounding as Rounding, White as White
from hident.signals.streams import NumpyStreams as NumpyStreams
from hident.systems.blocks import Hammerstein as Hammerstein, HammersteinWiener as HammersteinWiener
from hident.systems.blocks import Wiener as Wiener, WienerHammerstein as WienerHammerstein
from hident.systems.continuous import Continuous as Continuous, ContinuousZpk as ContinuousZpk
from hident.systems.linear import Ar as Ar, Arma as Arma, Fir as Fir
from hident.systems.sections import Sos as Sos, Zpk as Zpk
from hident.systems.memory import Backlash as Backlash, Relay as Relay
from hident.systems.nonlinearity import Abs as Abs, ChenType1 as ChenType1, ChenType2 as ChenType2
from hident.systems.nonlinearity import ChenType3 as ChenType3, ChenType4 as ChenType4, DeadZone as DeadZone
from hident.systems.nonlinearity import Exponential as Exponential, Expression as Expression
from hident.systems.nonlinearity import Identity as Identity, Mzyk2009 as Mzyk2009
from hident.systems.nonlinearity import PiecewiseLinear as PiecewiseLinear, Polynomial as Polynomial
from hident.systems.nonlinearity import Power as Power, Saturation as Saturation, Sign as Sign
from hident.systems.processes import AcidTank as AcidTank, PhNeutralisation as PhNeutralisation
from hident.systems.processes import VanDeVusse as VanDeVusse

__all__: list[str]
__version__: str
