/* SPDX-License-Identifier: Apache-2.0
 * Role: the C ABI of libvshift.so, for hosts such as Blender (ctypes). Links no OpenImageIO.
 *
 * Conventions: metres; matrices are row-major; world_from_cam is 3x4 (rotation | translation) with
 * the camera frame x right, y down, z forward; images are row-major, row 0 on top, pixel centre at
 * +0.5; depth is planar z, +inf is sky. Every function returns 0, or an exit code of
 * docs/conventions.md; vshift_last_error() then gives one line (per thread). NULL out-pointers are
 * skipped. Functions use all cores unless vshift_set_threads says otherwise, and give the same bytes
 * for any number of threads.
 */
#ifndef VSHIFT_C_API_H
#define VSHIFT_C_API_H
#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define VSHIFT_API __attribute__((visibility("default")))
#else
#define VSHIFT_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* "vshift X.Y.Z, Embree A.B.C" */
VSHIFT_API const char* vshift_version(void);
VSHIFT_API const char* vshift_last_error(void);
VSHIFT_API int vshift_set_threads(int threads);

/* Casts known rays at a known triangle: 0 when the ray tracer that was bound at load time works.
 * (A host that brings another Embree can shadow ours: every ray then misses without an error.) */
VSHIFT_API int vshift_self_test(void);

typedef struct {
    int32_t width, height;
    double fx, fy, cx, cy;     /* pixels */
    double world_from_cam[12]; /* row-major 3x4 */
} vshift_camera;

/* The true mesh of one instant. Vertices are given in world coordinates (double, xyz) and stored
 * relative to `origin` (3 doubles, e.g. the ego's position) so that floats keep their precision. */
typedef struct vshift_scene vshift_scene;
VSHIFT_API int vshift_scene_create(const double* vertices_xyz, size_t vertex_count, const uint32_t* triangles,
                                   size_t triangle_count, const double origin[3], vshift_scene** out);
VSHIFT_API void vshift_scene_free(vshift_scene* scene);

/* Camera rays through all pixel centres. depth: H*W float, planar z, +inf where nothing is hit;
 * triangle: H*W int32 index or -1; normal: H*W*3 float geometric unit normal, world frame, turned
 * towards the camera; position: H*W*3 double, world. */
VSHIFT_API int vshift_cast_camera(const vshift_scene* scene, const vshift_camera* camera, float* depth,
                                  int32_t* triangle, float* normal, double* position);

/* Free rays from world origins along unit directions. distance: metres, +inf where nothing is hit. */
VSHIFT_API int vshift_cast_rays(const vshift_scene* scene, const double* origins_xyz, const double* directions_xyz,
                                size_t count, float* distance, int32_t* triangle);

/* Truth for the pixels of recorded camera `own` of the rig against V = `shifted` (method.md 5).
 * flags: H*W uint8, bits below. `rig` are all recorded cameras of the same instant. */
enum {
    VSHIFT_TRUTH_OCCLUDED = 1,   /* scene truth: hidden from V's centre */
    VSHIFT_TRUTH_OUTSIDE = 2,    /* does not project into V's image */
    VSHIFT_TRUTH_SKY = 4,        /* no surface: handled by direction */
    VSHIFT_TRUTH_SHELL_SELF = 8, /* occluded by a surface that `own` itself saw */
    VSHIFT_TRUTH_SHELL_RIG = 16, /* occluded by a surface that some camera of the rig saw */
    VSHIFT_TRUTH_FACES_AWAY = 32 /* occluded because the surface faces away from V */
};
VSHIFT_API int vshift_truth_recorded(const vshift_scene* scene, const vshift_camera* rig, int32_t rig_count,
                                     int32_t own, const vshift_camera* shifted, uint8_t* flags);

/* Truth for the pixels of the shifted camera V: who saw the surface that V sees.
 * klass: H*W uint8, values below; source: H*W int8 index into rig of the camera that saw it (own
 * camera first, then the neighbour nearest in viewing direction), -1 nobody; depth: H*W float. */
enum {
    VSHIFT_SEEN_BY_OWN = 0,
    VSHIFT_NEIGHBOUR_OCCLUDED = 1, /* own camera had it in frame but hidden; a neighbour saw it */
    VSHIFT_NEIGHBOUR_OUTSIDE = 2,  /* out of own camera's frame; a neighbour saw it */
    VSHIFT_NOBODY_OCCLUDED = 3,    /* in own frame but hidden; nobody saw it */
    VSHIFT_NOBODY_OUTSIDE = 4      /* out of own frame; nobody saw it */
};
VSHIFT_API int vshift_truth_shifted(const vshift_scene* scene, const vshift_camera* rig, int32_t rig_count, int32_t own,
                                    const vshift_camera* shifted, uint8_t* klass, int8_t* source, float* depth);

/* Distance from a point to the nearest surface within `limit_m` along a sphere of test directions,
 * and whether the point lies inside a closed surface (majority of rays that leave through back
 * faces). clearance_m: smallest hit distance, or limit_m. inside: 0 or 1. */
VSHIFT_API int vshift_clearance(const vshift_scene* scene, const double point[3], double limit_m, double* clearance_m,
                                int32_t* inside);

#ifdef __cplusplus
}
#endif
#endif
