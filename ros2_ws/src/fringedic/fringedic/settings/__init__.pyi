from .camera import CameraSettings as CameraSettings
from .devices import Devices as Devices
from .devices import DeviceSettings as DeviceSettings
from .load_frame import LoadFrameSettings as LoadFrameSettings
from .load_frame import MachineSettings as MachineSettings
from .projector import ProjectorSettings as ProjectorSettings
