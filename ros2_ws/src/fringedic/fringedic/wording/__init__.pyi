from .arguments import check_arguments as check_arguments
from .causes import cause_of as cause_of
from .numbers import counted as counted
from .numbers import grouped as grouped
from .numbers import number_text as number_text
from .optional_packages import optional_import as optional_import
from .yaml_text import InvalidYamlError as InvalidYamlError
from .yaml_text import load_yaml as load_yaml
