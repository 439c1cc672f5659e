from .comparison import Difference as Difference
from .comparison import compare_bits as compare_bits
from .parts import Part as Part
from .parts import Result as Result
from .run import Audit as Audit
from .run import audit_run as audit_run
