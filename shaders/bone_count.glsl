// How many bones a palette holds: the 52 joints of SMPL+H; player/plan.py writes another number where an avatar of the
// scene has twist joints (avatar/twist.py).
const int BONE_COUNT = 52;
