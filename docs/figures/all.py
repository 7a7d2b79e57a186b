"""Draw all figures of the docs anew: `make figures`. Streets are simulated where they are missing."""

import algorithm
import limits
import objects
import overlay
import results
import rig

import ovmot

if __name__ == "__main__":
    ovmot.prepare_process()
    for script in (rig, results, algorithm, objects, limits, overlay):
        print(script.__name__, flush=True)
        script.main()
