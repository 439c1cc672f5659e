from .animation import save_animation as save_animation
from .maps import save_pictures as save_pictures
