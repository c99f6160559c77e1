#!/bin/sh
# Whether the estimated error is the true one: relMSE by a run's own account (estimated_relative_error, squared) over relMSE against a long reference.
# Reports, asserts nothing.
#
#   sh test/bench_estimate.sh ./mlt [SEEDS [BUDGETS [REFERENCE [FOLDER]]]]
#
# BUDGETS are mutations per pixel ('32 100 320 1000'), so that nothing depends on the load; path and bdpt get a fifth as many samples. The reference of a
# scene is merged from three runs of mlt of REFERENCE (4000) mutations per pixel each; it is kept in FOLDER and used again. SCENES and WAYS in the
# environment name others. For each scene, way and budget: the median of the ratio over seeds, the least and largest, and the means of both errors;
# a reference's own error is a part of the second. FOLDER/estimate.csv keeps all. The default takes about an hour.
mlt=$1
seeds=${2:-16}
budgets=${3:-32 100 320 1000}
reference=${4:-4000}
folder=${5:-build/bench/estimate}
mkdir -p "$folder" || exit 1
size() { case $1 in cornell) echo 64x64 ;; glossy) echo 96x64 ;; *) echo 80x60 ;; esac; }
csv=$folder/estimate.csv
: >"$csv"
for scene in ${SCENES:-cornell glossy door caustic pool}; do
    long=$folder/$scene.pfm
    if [ ! -f "$long" ]; then
        for seed in 1001 1002 1003; do
            "$mlt" -q -s "$(size "$scene")" -n "$reference" --seed $seed --save "$folder/$scene.$seed" -o "$folder/run.pfm" "scenes/$scene.obj" || exit 1
        done
        "$mlt" merge -o "$long" "$folder/$scene.1001" "$folder/$scene.1002" "$folder/$scene.1003" || exit 1
    fi
    for way in ${WAYS:-mlt path bdpt}; do
        for n in $budgets; do
            [ "$way" = mlt ] || n=$(((n + 4) / 5))
            seed=1
            while [ "$seed" -le "$seeds" ]; do
                "$mlt" -q -s "$(size "$scene")" -n "$n" --seed "$seed" --integrator "$way" --stats "$folder/run.json" -o "$folder/run.pfm" "scenes/$scene.obj" || exit 1
                echo "$scene,$way,$n,$seed,$(sed -n 's/.*"estimated_relative_error": \([^,]*\),/\1/p' "$folder/run.json"),$("$mlt" compare "$folder/run.pfm" "$long" | sed -n 's/^relmse //p')" >>"$csv"
                seed=$((seed + 1))
            done
        done
    done
done
rm -f "$folder/run.pfm" "$folder/run.json"
echo '| scene | way | per pixel | median ratio | least, largest | mean relMSE estimated | true |'
echo '| --- | --- | --- | --- | --- | --- | --- |'
awk -F , '{ printf "%s,%s,%s,%.9g,%.9g,%.9g\n", $1, $2, $3, $5 * $5 / $6, $5 * $5, $6 }' "$csv" | sort -t , -k 1,1 -k 2,2r -k 3,3n -k 4,4g | awk -F , '
    function flush() { if (n) printf "| %s | %.2f | %.2f, %.2f | %.2g | %.2g |\n", key, (ratio[int((n + 1) / 2)] + ratio[int((n + 2) / 2)]) / 2, ratio[1], ratio[n], estimated / n, true / n }
    { now = "`" $1 "` | " $2 " | " $3; if (now != key) { flush(); key = now; n = estimated = true = 0 } ratio[++n] = $4; estimated += $5; true += $6 }
    END { flush() }'
