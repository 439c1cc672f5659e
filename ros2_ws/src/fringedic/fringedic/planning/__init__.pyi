from .plan import Plan as Plan
from .plan import make_plan as make_plan
from .planned_rig import PlannedRig as PlannedRig
