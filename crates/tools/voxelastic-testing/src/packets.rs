//! UDP packets as sensors that turn send them, of whatever they are to have measured.

/// A turn takes a tenth of a second.
const DEGREES_PER_US: f64 = 3600.0 / 1e6;
/// Elevations of the lasers of a VLP-16, degrees, in the order of firing.
const VLP16_DEGREES: [f64; 16] = [-15.0, 1.0, -13.0, 3.0, -11.0, 5.0, -9.0, 7.0, -7.0, 9.0, -5.0, 11.0, -3.0, 13.0, -1.0, 15.0];
/// Time between two firings of all lasers of a VLP-16, microseconds.
const VLP16_FIRING_US: f64 = 55.296;
/// Edges of the steps in which distances are sent, metres.
const VLP16_STEP_M: f64 = 0.002;
const XT32_STEP_M: f64 = 0.004;

/// A laser's beam.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Number of the beam since the first packet.
    pub number: usize,
    /// Clockwise, seen from above; degrees.
    pub azimuth: f64,
    /// Above the horizon, degrees.
    pub elevation: f64,
}

/// What a beam has measured: the distance in metres, 0 if nothing came back, and the intensity.
pub type Measured = (f64, u8);

fn azimuth_bytes(us: f64) -> [u8; 2] {
    (((us * DEGREES_PER_US * 100.0).round() as u64 % 36_000) as u16).to_le_bytes()
}

fn returned((distance, intensity): Measured, step_m: f64) -> [u8; 3] {
    let [low, high] = ((distance / step_m).round() as u16).to_le_bytes();
    [low, high, intensity]
}

/// Packets of a VLP-16 during some turns, each with its time in seconds: twelve blocks of two firings. `start` is the time of the first, seconds since 1970.
pub fn velodyne(start: f64, turns: f64, measure: impl Fn(Beam) -> Measured) -> Vec<(f64, Vec<u8>)> {
    let block_us = 2.0 * VLP16_FIRING_US;
    let packet_us = 12.0 * block_us;
    let packet = |n: usize| {
        let us = n as f64 * packet_us;
        let mut bytes = Vec::new();
        for block in 0..12 {
            let block_at = us + block as f64 * block_us;
            bytes.extend([0xff, 0xee]);
            bytes.extend(azimuth_bytes(block_at));
            for k in 0..32 {
                let azimuth = (block_at + (k / 16) as f64 * VLP16_FIRING_US) * DEGREES_PER_US % 360.0;
                let beam = Beam { number: (n * 12 + block) * 32 + k, azimuth, elevation: VLP16_DEGREES[k % 16] };
                bytes.extend(returned(measure(beam), VLP16_STEP_M));
            }
        }
        bytes.extend(((start % 3600.0 * 1e6 + us).round() as u32).to_le_bytes());
        bytes.extend([0x37, 0x22]);
        (start + us * 1e-6, bytes)
    };
    (0..(turns * 1e5 / packet_us) as usize).map(packet).collect()
}

/// Packets of a PandarXT-32 during some turns, each with its time in seconds: eight blocks, 50 us apart. Its date was never set.
pub fn hesai(start: f64, turns: f64, measure: impl Fn(Beam) -> Measured) -> Vec<(f64, Vec<u8>)> {
    let packet = |n: usize| {
        let us = (n + 1) as f64 * 400.0;
        let mut bytes = vec![0xee, 0xff, 6, 1, 0, 0, 32, 8, 0, 4, 1, 1];
        for block in 0..8 {
            let block_at = us - 50.0 * (7 - block) as f64;
            bytes.extend(azimuth_bytes(block_at));
            for k in 0..32 {
                let beam = Beam { number: (n * 8 + block) * 32 + k, azimuth: block_at * DEGREES_PER_US % 360.0, elevation: 15.0 - k as f64 };
                bytes.extend(returned(measure(beam), XT32_STEP_M));
                bytes.push(0);
            }
        }
        let micros = (us.rem_euclid(1e6) as u32).to_le_bytes();
        bytes.extend([&[0; 10][..], &[0x37, 0, 0, 123, 11], &[14, 22, 25, (us * 1e-6) as u8], &micros, &[0x42, 0, 0, 0, 0]].concat());
        (start + us * 1e-6, bytes)
    };
    (0..(turns * 1e5 / 400.0) as usize).map(packet).collect()
}
