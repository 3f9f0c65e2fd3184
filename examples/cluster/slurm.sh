#!/bin/sh
# Submits three jobs that compute moments in parts, add them, and fit a model: sh slurm.sh SAMPLES [PARTS]
# Prints the numbers of the three jobs. TASKS=3,7 submits only these parts, and the jobs that depend on them.
set -eu
samples=$1 parts=${2:-16}
columns="--vectors 0 1 2 --values 3"
moments_degree=${MOMENTS_DEGREE:-1000} fit_degree=${FIT_DEGREE:-720}
folder=${FOLDER:-.}

# A part whose file exists is skipped, so the array can be submitted again. Files are written completely or not at all.
array=$(sbatch --parsable --array="${TASKS:-0-$((parts - 1))}" --cpus-per-task=2 --job-name=moments --wrap "
  part=$folder/part\$SLURM_ARRAY_TASK_ID.moments
  test -e \$part || spharm moments --samples $samples $columns --max-degree $moments_degree \
    --shard \$SLURM_ARRAY_TASK_ID/$parts --output \$part")

# If a job fails, the jobs that depend on it are cancelled.
after="--kill-on-invalid-dep=yes --dependency"
merge=$(sbatch --parsable $after="afterok:$array" --job-name=merge --wrap "
  spharm moments merge \$(seq -f '$folder/part%.0f.moments' 0 $((parts - 1))) --force --output $folder/all.moments")

fit=$(sbatch --parsable $after="afterok:$merge" --cpus-per-task=2 --job-name=fit --wrap "
  spharm fit --moments $folder/all.moments --max-degree $fit_degree --force --output $folder/all.spharm.npz")
echo "$array $merge $fit"
