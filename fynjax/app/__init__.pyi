from . import assembly as assembly
from . import cli as cli
from . import compare as compare
from . import io as io
from . import jobs as jobs
from . import report as report
from . import terrain as terrain
