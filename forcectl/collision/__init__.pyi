from forcectl.collision.distance import LinkDistance as LinkDistance
from forcectl.collision.shapes import Obstacle as Obstacle
from forcectl.collision.shapes import RobotShapes as RobotShapes
from forcectl.collision.shapes import cover as cover
