from .programme import Programme as Programme
from .rig_file import RigFile as RigFile
from .rig_file import load_programme as load_programme
from .rig_file import load_rig_file as load_rig_file
from .rig_sensors import RigSensors as RigSensors
from .rig_sensors import load_rig_sensors as load_rig_sensors
