#!/bin/sh
# Error at equal time: relMSE against a long reference, mean over seeds, for the path tracer, the bidirectional one, mlt with bidirectional
# mutations alone, in full, and with one strategy left out. Reports, asserts nothing.
#
#   sh test/bench_error.sh ./mlt [SECONDS [SEEDS [REFERENCE_SECONDS [FOLDER]]]]
#
# The films are small, so that few seconds stand for the minutes of a large one. References are kept in FOLDER and used again: by the path
# tracer where it converges (cornell, glossy), else by mlt with another seed.
mlt=$1
seconds=${2:-3}
seeds=${3:-8}
reference=${4:-120}
folder=${5:-build/bench}
mkdir -p "$folder" || exit 1
size() { case $1 in cornell) echo 64x64 ;; glossy) echo 96x64 ;; *) echo 80x60 ;; esac; }
how() { case $1 in cornell | glossy) echo path ;; *) echo mlt ;; esac; }

# mean relMSE over the seeds of one way to render one scene
row() {
    scene=$1
    name=$2
    shift 2
    seed=1
    while [ "$seed" -le "$seeds" ]; do
        "$mlt" -q -s "$(size "$scene")" -t "$seconds" --seed "$seed" -o "$folder/run.$$.pfm" "$@" "scenes/$scene.obj" || exit 1
        "$mlt" compare "$folder/run.$$.pfm" "$folder/$scene.pfm"
        seed=$((seed + 1))
    done | awk -v scene="$scene" -v name="$name" '/^relmse/ { n++; sum += $2; log_sum += log($2) }
        END { printf "%-8s %-16s %.5f %.5f\n", scene, name, sum / n, exp(log_sum / n) }'
    rm -f "$folder/run.$$.pfm"
}

echo "scene    way              relMSE: mean, geometric mean over $seeds seeds of $seconds s"
for scene in ${SCENES:-cornell glossy door caustic pool}; do
    [ -f "$folder/$scene.pfm" ] || "$mlt" -q -s "$(size $scene)" -t "$reference" --seed 1000 --integrator "$(how $scene)" -o "$folder/$scene.pfm" "scenes/$scene.obj" || exit 1
    row $scene path --integrator path
    row $scene bdpt --integrator bdpt
    row $scene 'mlt bidir alone' --strategies bidir
    row $scene mlt
    row $scene '- lens' --strategies bidir,caustic,chain,subpath
    row $scene '- subpath' --strategies bidir,lens,caustic,chain
    case $scene in cornell | glossy) continue ;; esac       # nothing specular: never proposed
    row $scene '- caustic' --strategies bidir,lens,chain,subpath
    row $scene '- chain' --strategies bidir,lens,caustic,subpath
done
