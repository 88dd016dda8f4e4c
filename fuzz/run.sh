#!/bin/sh
# Runs every fuzz target for a while, one after the other: run.sh SECONDS [TARGET..]. Findings are left in fuzz/artifacts.
cd "$(dirname "$0")" || exit 1
seconds=$1
shift
for target in ${*:-ros1 mcap sqlite ouster packets las e57 pcd ply bin poses message dumps images manifest journal http frames}; do
    mkdir -p "corpus/$target"
    RUSTC_BOOTSTRAP=1 cargo fuzz run --sanitizer none "$target" "corpus/$target" "seeds/$target" -- \
        -max_total_time="$seconds" -timeout=10 -rss_limit_mb=2048 -max_len=100000 -verbosity=1 -print_final_stats=1 2>&1 |
        grep -aE "stat::(number_of_executed|new_units|slowest|peak)|SUMMARY|ERROR|panicked|Test unit written|cov: [0-9]+.*DONE" |
        sed "s/^/$target: /"
done
