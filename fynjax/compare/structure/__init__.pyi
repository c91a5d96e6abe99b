from ._compare import cloud_structure as cloud_structure
from ._compare import compare_clouds as compare_clouds
from ._grain import cut_off as cut_off
from ._published import PublishedStructure as PublishedStructure
from ._published import structure_2006 as structure_2006
from ._result import StructureComparison as StructureComparison
from ._settings import ComparisonSettings as ComparisonSettings
from ._settings import cloud_settings as cloud_settings
