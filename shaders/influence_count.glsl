// How many joints a vertex follows at most; player/draw/plan.py writes a smaller number where no vertex of a scene
// follows so many.
const int INFLUENCES = 4;
