from .motion_limit import MotionLimit as MotionLimit
from .motion_limit import motion_limit as motion_limit
from .plan import Plan as Plan
from .plan import make_plan as make_plan
from .planned_rig import PlannedRig as PlannedRig
