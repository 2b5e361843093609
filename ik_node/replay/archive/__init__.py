"""Many recordings replayed side by side, with one table as the result.

``bags`` finds recordings in folders and behind fsspec URLs. ``row.replay_bag`` replays one and describes it as a
:class:`~ik_node.replay.archive.row.BagRow`; it runs in a process of this computer (``local_pool``) or on a Dask cluster
(``dask_cluster``). ``run`` distributes the bags, keeps each finished row, and skips those that are kept already.
``table`` writes the rows as text, CSV, JSON and Parquet, ``page`` as one HTML page.
"""
