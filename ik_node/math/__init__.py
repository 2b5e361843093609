"""Numbers without robots: rotations, rigid motions, pseudoinverses and the small functions that other folders share.

``types`` names the array type. ``quaternion`` and ``so3`` hold rotations as tuples of floats for compiled code;
``se3`` holds poses as 4x4 arrays, twists as arrays (v, omega), and the checks that poses pass when they enter the
package. ``task_tolerance`` states which part of a pose matters, ``task_error`` computes the error to it. ``angles``
subtracts joint positions. ``pseudoinverse`` decomposes Jacobians. ``numerics`` has smoothstep, low-discrepancy points
and the checks of vectors, matrices and numbers that raise InputError.

Input is checked once, where it enters; compiled functions expect C-contiguous float64 arrays and check nothing.
"""
