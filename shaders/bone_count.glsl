// How many bones a palette holds: the 52 joints of SMPL+H; player/draw/plan.py writes another number where an avatar
// of the scene has helper joints (avatar/helper_joints.py).
const int BONE_COUNT = 52;
