// How many bones a palette holds: the 52 joints of SMPL+H, more where an avatar of the scene has helper joints
// (avatar/helper_joints.py); and how many joints a vertex follows at most. player/draw/plan.py writes a scene's own.
const int BONE_COUNT = 52;
const int INFLUENCES = 4;
