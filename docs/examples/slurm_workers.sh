#!/bin/bash
# A batch on Slurm, first part: the workers. Not run by our tests: we have no such cluster.
#SBATCH --job-name=maps-workers
#SBATCH --array=1-16
#SBATCH --cpus-per-task=8
#SBATCH --mem=32G
#SBATCH --time=08:00:00
exec dask worker --scheduler-file "$HOME/maps.json" --nworkers 8 --nthreads 1 \
  --memory-limit 4GB --local-directory "$TMPDIR" --death-timeout 600
