"""Measurements that take too long for tests or depend on the machine; not part of the installed package.

``python3 bootstrap.py ik_benchmark NAME`` runs one, ``python -m benchmarks NAME`` does the same in a prepared
environment. Each benchmark is a module with ``main(arguments) -> int``; ``__main__`` lists them. Benchmarks of several
sections use :mod:`benchmarks.sections`. Baselines (other control laws, published methods) are implemented here.

    ik              haviland_corke, published
    limits          limit_stress, singularities, on loop
    obstacles       scenes, on loop
    streams         stream_data -> stream_baselines -> stream_metrics
    tracking        tracking_targets -> tracking_arm -> tracking_rows; tracking_dds with the node in its own process
    recording       real_time_loop
    replay
"""
