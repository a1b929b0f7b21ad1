// SPDX-License-Identifier: Apache-2.0
// Role: a whole inpainting model, from condition to pixels, and its file. Stage: inpaint (paper III-E).
//
// In pixels the network predicts (target - fill) * residual_scale where pixels may change and sees the fill, the masks
// and 1/z; its output begins at zero, that is at the fill. In latents it predicts the target's latent and sees the
// condition's (and the masks as shares of a latent's area), as the paper says. Either comes as one step (regression:
// the velocity at t = 1 from z1 = 0) or as flow matching. What may not change is neither noise nor moved: known latents
// stay the condition's, known pixels come back bit for bit. An autoencoder is trained first and alone; it fills
// nothing. pixel_rays is regression pixel by pixel (ray_mixer.h), and changes holes alone. With a `start`, a flow in
// pixels has such a model inside: what that gives takes the fill's place, and z1 is its texture and noise, not noise
// alone.
#pragma once
#include "inpaint/dit.h"
#include "inpaint/flow.h"
#include "inpaint/ray_mixer.h"
#include "inpaint/unet.h"
#include "inpaint/vae.h"

namespace vshift::inpaint {

enum class Kind { pixel_unet, pixel_dit, latent_dit, autoencoder, pixel_rays };

/// Where a flow begins that has a pixel_rays inside: z1 = rays.detail x texture + noise. In training the truth's own
/// texture (its deviation from the rays' colors, less that deviation's mean nearby) takes the place of a part of it:
/// detail x (coupling x the truth's + sqrt(1 - coupling^2) x the surface's), as strong as either where they are alike.
struct StartConfig {
    double noise = 0.02;  ///< standard deviation, display values
    double coupling = 0;  ///< 0: z1 knows nothing of the truth; below 1
    double gain = 1;      ///< in filling the texture is so many times as strong: a mean's steps take away some of it
};

struct ModelConfig {
    Kind kind = Kind::pixel_unet;
    bool flow = false;       ///< else regression
    bool masks = true;       ///< hole and neighbour channels are seen
    bool depth = true;       ///< 1/z is seen
    bool neighbors = false;  ///< trained on conditions that have neighbours' pixels
    int64_t window = 0;      ///< frames that attention looks at; 0: all of them, no streaming
    double time_shift = 1;   ///< Wan's, in training and sampling
    /// The network's output is z0 (in latents: less the condition's), from which v = (z_t - z0) / t follows; else v
    /// itself.
    bool gives_data = false;
    double early_time = 0.25;  ///< of such a network, in training: v's error below this t counts as that at it
    double residual_scale = 4;
    UnetConfig unet;
    bool has_start = false;  ///< of flows in pixels
    StartConfig start;
    RayMixerConfig rays;  ///< of pixel_rays and of a start
    DitConfig dit;
    VaeConfig vae;
};
/// Whether it works on pixels: neither in latents nor an autoencoder.
inline bool in_pixels(const ModelConfig& config) {
    return config.kind != Kind::latent_dit && config.kind != Kind::autoencoder;
}
/// `file` begins messages. Channel counts follow from the rest and are filled in.
ModelConfig parse_model_config(const std::string& json, const std::string& file);
std::string json_of(const ModelConfig& config);

struct Model {
    ModelConfig config;
    Weights weights;                              ///< what training changes
    Weights rays;                                 ///< of a start: frozen
    Vae vae;                                      ///< latent kinds: frozen; of an autoencoder only the config
    std::map<std::string, std::string> metadata;  ///< license, training record
};

Model initial_model(const ModelConfig& config, uint64_t seed);
/// A latent model with the autoencoder of `file`: one that vshift trained, or Wan2.2's under either set of names, whose sizes,
/// mean and std are then the config's.
Model initial_model(const ModelConfig& config, uint64_t seed, const std::filesystem::path& file);
/// A flow with a start: the pixel_rays of `file`.
Model initial_model_with_start(const ModelConfig& config, uint64_t seed, const std::filesystem::path& file);
/// Gives a pixel_unet the weights of a regression of the same network: at t = 1 it then predicts what that does, and of
/// the noise it knows nothing yet.
void begin_with_regression(Model& model, const std::filesystem::path& file);
/// Gives a latent_dit the weights of `file`, one or its index: Wan2.2's, under either set of names. Input channels that it
/// lacks are Kaiming-uniform (paper III-E); its text conditioning is left out.
void begin_with_dit(Model& model, const std::filesystem::path& file, uint64_t seed);
/// Config, license and training record lie in the file's metadata; throws Error bad_input for what does not fit.
Model load_model(const std::filesystem::path& file);
void save_model(const std::filesystem::path& file, const Model& model, const Weights& weights);

/// What a model works on, display values (sRGB) in 0..1 and shares in 0..1: [B, C, F, H, W].
struct Views {
    Tensor fill;           ///< 3: the condition with its holes filled classically; by rays, once started() has seen it
    Tensor hole;           ///< 1: nobody saw it
    Tensor neighbor;       ///< 1: pasted from a neighbour
    Tensor inverse_depth;  ///< 1, in 1/m; 0 in holes and sky
    Tensor target;         ///< 3: training only
    Tensor weight;         ///< 1: how much an error counts in training; undefined: hole or neighbor
    Tensor texture;        ///< 3: of models with a start, what started() gives; else undefined
    Tensor seen;  ///< training of pixel_rays, whose pixels are drawn from many views: ray_mixer_forward's input
};

/// H and W that the model takes are multiples of this.
int64_t model_side(const ModelConfig& config);

/// Grown at the right and lower borders to what the model takes; what is added is known and repeats the border.
Views padded(const ModelConfig& config, const Views& views);

/// Of a pixel_rays, or a model with a start: its colors in place of the fill, and their texture beside them.
Views started(const Model& model, const Views& views);

/// The network's space: what it is asked for, what it sees, and where it counts.
struct Example {
    Tensor z0;          ///< [B, Z, F, h, w]; undefined without a target
    Tensor condition;   ///< [B, C, F, h, w]
    Tensor texture;     ///< of models with a start: as z0, before it is weighed; else undefined
    Tensor may_change;  ///< [B, 1, F, h, w]: share
    Tensor weight;      ///< the same size: how much an error counts
};
Example prepare(const Model& model, const Views& views, VaeState* target_state = nullptr,
                VaeState* condition_state = nullptr);

/// Where a flow begins, of standard normal `noise`; `z0` in training alone, for a coupling.
Tensor beginning(const ModelConfig& config, const Example& example, const Tensor& noise, const Tensor& z0 = {});

/// v at t (0..1, [B]) of the noisy `z`.
Tensor velocity(const Model& model, const Weights& weights, const Tensor& z, const Tensor& t, const Tensor& condition,
                const DitOptions& options = {});

/// The mean over samples of the weighted squared error of v; `noise` standard normal, `t` in 0..1 ([B]). Regression
/// ignores both. Where the network gives z0, v's error would grow without bound towards t = 0: hence `early_time`.
Tensor loss_of(const Model& model, const Weights& weights, const Example& example, const Tensor& noise,
               const Tensor& t);

/// A stream of frames: what the next piece needs of the past. Memory does not grow.
struct Stream {
    int64_t frames = 0;
    std::vector<DitCache> caches;  ///< one for each sampling step
    VaeState condition, output;
    struct {
        double encode = 0, network = 0, decode = 0;
    } cpu_s;  ///< of the process, so far: where the time goes
};
/// What the frames of a stream's pieces are a multiple of, after the first, which is one frame.
int64_t piece_frames(const ModelConfig& config);

/// The filled view(s), [B, 3, F, H, W] in 0..1, any H and W. `steps` counts for flow alone; the noise depends on the
/// seed and the frame's number, so that a stream in any pieces gives the same pictures. Models without a window take a
/// stream's frames piece by piece, each for itself.
Tensor inpaint(const Model& model, const Views& views, int steps, uint64_t seed, Stream& stream);

/// What `noise` an example needs: a sample's z1, or what moves an autoencoder's latents.
std::vector<int64_t> noise_sizes(const Model& model, const Example& example);

/// How an autoencoder gives back views' targets: PSNR; and its latents' mean and standard deviation by channel, as a
/// model's config has them.
struct Reconstruction {
    double psnr_db = 0;
    std::vector<float> mean, std;
};
Reconstruction reconstruction_of(const Model& model, const Weights& weights, const std::vector<Views>& views);

/// Standard normal numbers that depend on seed and number alone.
Tensor noise(at::IntArrayRef sizes, uint64_t seed, uint64_t number);

}  // namespace vshift::inpaint
