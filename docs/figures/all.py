"""Draw all figures of the docs anew (`make figures`); streets are simulated where missing."""

import algorithm
import limits
import objects
import overlay
import ovmot
import results
import rig

if __name__ == "__main__":
    ovmot.prepare_process()
    for script in (rig, results, algorithm, objects, limits, overlay):
        print(script.__name__, flush=True)
        script.main()
